"""Opening splat files: time and memory of this checkout against those of another one.

Writes a scene as PLY, SPZ and SOG, and opens each file with both checkouts in turn, each time in a
process of its own. Prints the least times, the peaks of memory and their ratios.

    .venv/bin/python tests/bench/bench_opening.py --against ../main --splats 1000000
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("contract", "sdk", "reference_plugins", "runtime")

WRITE = """
import sys
from pathlib import Path
import numpy as np
from gsgen.formats import Splats, write_ply, write_sog, write_spz
count, folder = int(sys.argv[1]), Path(sys.argv[2])
rng = np.random.default_rng(0)
draw = lambda *shape, size=1.0, middle=0.0: (middle + size * rng.standard_normal((count, *shape))).astype("f4")
splats = Splats(position=draw(3, size=3), rotation=draw(4), log_scale=draw(3, size=.7, middle=-4),
                logit_opacity=draw(size=2), sh=draw(4, 3, size=.25))
write_ply(folder / "a.ply", splats)
write_spz(folder / "a.spz", splats)
write_sog(folder / "a.sog", splats)
"""
OPEN = """
import json, resource, sys, time, warnings
warnings.simplefilter("ignore")
from gsgen.formats import open_splats
start = time.process_time()
splats = open_splats(sys.argv[1])
seconds = time.process_time() - start
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([seconds, peak, len(splats)]))
"""


def run(checkout: Path, script: str, *arguments: str) -> str:
    """Run a script with the packages of a checkout; return what it printed."""
    folders = [str(checkout / part) for part in PARTS]
    setup = f"import sys; sys.path[:0] = {folders!r}\n"
    command = [sys.executable, "-c", setup + script, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main() -> None:
    """Print one line per format."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path, required=True, help="another checkout")
    parser.add_argument("--splats", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        run(ROOT, WRITE, str(options.splats), folder)
        for name in ("a.ply", "a.spz", "a.sog"):
            measures: dict[Path, list[list[float]]] = {ROOT: [], options.against.resolve(): []}
            for _ in range(options.rounds):
                for checkout, results in measures.items():
                    results.append(json.loads(run(checkout, OPEN, f"{folder}/{name}")))
            (seconds, peak), (old_seconds, old_peak) = (
                [min(result[column] for result in results) for column in (0, 1)]
                for results in measures.values()
            )
            print(
                f"{name}: {seconds:.3f} s against {old_seconds:.3f} s, ratio "
                f"{seconds / old_seconds:.2f}; {peak:.0f} MiB against {old_peak:.0f} MiB, ratio "
                f"{peak / old_peak:.2f}"
            )


if __name__ == "__main__":
    main()

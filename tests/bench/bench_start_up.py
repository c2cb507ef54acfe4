"""Processor time and modules of a command's start, in multiples of `import onnx` of the same run.

    python tests/bench/bench_start_up.py

Each row is the least of five processes. The bars: `--help` 1.6, `--version` 0.6, `validate --level
static` 2 with typer 0.28 and 2.6 with the newest; modules of gsgen: `validate` 150, `render` 240.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from gsgen.conformance.fixtures import find
from gsgen.formats import write_ply
from gsgen.reference_plugins.samples import garden

_COUNT = """
import sys
from gsgen.cli import main
try:
    main()
finally:
    names = [name for name in sys.modules if name.partition(".")[0] == "gsgen"]
    tiles = [name for name in names if name.startswith("gsgen.tiles")]
    print(len(names), len(tiles), file=sys.stderr)
"""


# Some containers forbid Python to write bytecode: then each process compiles all modules.
_ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def processor_seconds(*words: str) -> float:
    """Return the least processor time of five processes of Python with these arguments."""
    seconds = []
    for _ in range(5):
        process = os.posix_spawn(
            sys.executable,
            [sys.executable, *words],
            _ENVIRONMENT,
            file_actions=[(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)],
        )
        _, status, used = os.wait4(process, 0)
        assert os.waitstatus_to_exitcode(status) == 0, words
        seconds.append(used.ru_utime + used.ru_stime)
    return min(seconds)


def modules(*words: str) -> str:
    """Return how many modules of gsgen a command imports, and how many of gsgen.tiles."""
    completed = subprocess.run(
        [sys.executable, "-c", _COUNT, *words], capture_output=True, text=True, check=True
    )
    total, tiles = completed.stderr.split()[-2:]
    return f"{total} modules, {tiles} of tiles"


def main() -> None:
    """Print a line for each command."""
    with tempfile.TemporaryDirectory() as folder:
        model = find("still_sh0").write(Path(folder))
        write_ply(Path(folder) / "x.ply", garden(2000))
        render = ("render", f"{folder}/x.ply", "-o", f"{folder}/x.png")
        commands = (
            ("--version",),
            ("--help",),
            ("validate", "--level", "static", str(model)),
            (*render, "--width", "64", "--height", "48"),
        )
        onnx = processor_seconds("-c", "import onnx")
        print(f"import onnx: {onnx:.3f} s of processor time")
        empty = processor_seconds("-c", "pass")
        share = (processor_seconds("-c", "import gsgen") - empty) / (onnx - empty)
        print(f"import gsgen: {share:.2f} × import onnx, both beyond an empty program; bar 0.2")
        for words in commands:
            share = processor_seconds("-m", "gsgen.cli", *words) / onnx
            print(f"gsgen {words[0]}: {share:.2f} × import onnx, {modules(*words)}")


if __name__ == "__main__":
    main()

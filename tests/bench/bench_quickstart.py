"""Print how long the quickstart takes each of its four readers, from an empty folder with a wheel.

For each Python and each heading of docs/quickstart.md: a new environment, the wheel with the extras
that the section names, then its marked blocks as they stand. Exits 1 if a step fails or a path takes
longer than the bar.

    make wheel
    .venv/bin/python tests/bench/bench_quickstart.py dist/*.whl --python python3.11 python3.13
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.commands import ROOT
from support.reports.pages import DOCS, blocks_of

MOST_MINUTES = 15
PAGE = DOCS / "quickstart.md"
CONSTRAINTS = ROOT / "constraints.txt"


def main() -> int:
    """Run every path with every Python."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--python", nargs="+", default=[sys.executable])
    parser.add_argument("--only", default="", help="A part of the heading of the paths to run.")
    arguments = parser.parse_args()
    first, *paths = PAGE.read_text("utf-8").split("\n## ")
    faults = 0
    for python in arguments.python:
        for path in (path for path in paths if arguments.only in path.splitlines()[0]):
            seconds, fault = _run_path(python, arguments.wheel.resolve(), first, path)
            faults += bool(fault) or sum(seconds) > 60 * MOST_MINUTES
            minutes = "{:.1f} min to install, {:.1f} min to run".format(*(s / 60 for s in seconds))
            print(f"{python}  {path.splitlines()[0]}: {minutes}  {fault or 'ok'}", flush=True)
    print(f"{faults} faults, bar 0; {MOST_MINUTES} minutes a path")
    return int(faults > 0)


def _run_path(python: str, wheel: Path, first: str, path: str) -> tuple[tuple[float, float], str]:
    """Return the seconds of the installation and of the blocks, and the first fault."""
    need = re.search(r"You need the extras? ([^.;:]+)", path)
    extras = ",".join(re.findall(r"`(\w+)`", need[1])) if need else ""
    with tempfile.TemporaryDirectory(prefix="gsgen-quickstart-") as name:
        folder = Path(name)
        binaries = folder / "env" / ("Scripts" if os.name == "nt" else "bin")
        environment = os.environ | {"PATH": f"{binaries}{os.pathsep}{os.environ['PATH']}"}
        environment.pop("PYTHONPATH", None)
        work = folder / "work"
        work.mkdir()
        start = time.monotonic()
        requirement = f"{wheel}[{extras}]" if extras else str(wheel)
        install = (
            f'{python} -m venv "{folder}/env" && pip install -q -c {CONSTRAINTS} "{requirement}"'
        )
        fault = _run(install, work, environment)
        installed = time.monotonic()
        for block in blocks_of(first) + blocks_of(path):
            if block.mark != "bash":
                (work / block.mark).write_text(block.text, "utf-8")
            script = block.text if block.mark == "bash" else f"python {block.mark}"
            fault = fault or _run(script, work, environment)
        return (installed - start, time.monotonic() - installed), fault


def _run(script: str, folder: Path, environment: dict[str, str]) -> str:
    """Run a script of bash that stops at an error; return the end of its errors if it fails."""
    command = ["bash", "-euo", "pipefail", "-c", script]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return "" if done.returncode == 0 else f"{script.strip()[:60]!r}: {done.stderr.strip()[-300:]}"


if __name__ == "__main__":
    raise SystemExit(main())

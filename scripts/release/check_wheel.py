"""Install the wheel of a folder into a new environment, measure it, and run the program there.

Exits 1 if the environment is larger than the bar, or if a command fails.

    python scripts/release/check_wheel.py dist
"""

import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

MOST_MEGABYTES = 250
"""The bar for an environment with the base wheel, in MiB, with pip."""
WRITE_MODEL = """
import sys
from pathlib import Path
from gsgen.conformance.fixtures import find
print(find(sys.argv[1]).write(Path()))
"""
EXPECTED = {"drift": (0, "conforms"), "opacity_is_logits": (1, "invalid")}
"""Example models, and the exit code and verdict of each."""


def main() -> int:
    """Check the wheel in the folder that the command line names."""
    if len(sys.argv) != 2:
        print("usage: check_wheel.py FOLDER", file=sys.stderr)
        return 2
    wheels = sorted(Path(sys.argv[1]).resolve().glob("gsgen-*.whl"))
    if len(wheels) != 1:
        print(f"{sys.argv[1]}: {len(wheels)} wheels of gsgen; expected 1", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="gsgen-wheel-") as name:
        return check(wheels[0], Path(name))


def check(wheel: Path, folder: Path) -> int:
    """Install ``wheel`` below ``folder``, and return the exit code of the checks."""
    venv.create(folder / "venv", with_pip=True)
    binaries = folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    python = binaries / "python"
    constraints = Path(__file__).resolve().parents[2] / "constraints.txt"
    pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-compile"]
    _run([*pip, "-c", constraints, wheel], folder)
    size = sum(file.stat().st_size for file in folder.rglob("*") if not file.is_symlink())
    megabytes = size / 2**20
    print(f"{wheel.name}: {megabytes:.0f} MiB installed; bar {MOST_MEGABYTES}")
    program = binaries / "gsgen"
    print(_run([program, "--version"], folder).strip())
    verdicts = [_verdict(program, python, name, folder) for name in EXPECTED]
    return 0 if megabytes <= MOST_MEGABYTES and all(verdicts) else 1


def _verdict(program: Path, python: Path, name: str, folder: Path) -> bool:
    code, verdict = EXPECTED[name]
    model = _run([python, "-c", WRITE_MODEL, name], folder).strip()
    report = json.loads(_run([program, "validate", model, "--json"], folder, code))
    print(f"{name}: {report['verdict']}; expected {verdict}")
    return bool(report["verdict"] == verdict)


def _run(command: list[str | Path], folder: Path, expected: int = 0) -> str:
    result = subprocess.run(command, cwd=folder, capture_output=True, encoding="utf-8")
    if result.returncode != expected:
        words = " ".join(map(str, command))
        sys.exit(f"`{words}` exits {result.returncode}; expected {expected}\n{result.stderr}")
    return result.stdout


if __name__ == "__main__":
    sys.exit(main())

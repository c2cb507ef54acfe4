"""What several test folders share: where data is, and how a user runs the program."""

import gc
import io
import os
import subprocess
import sys
import tempfile
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import pytest

from gsgen.cli.app import main

ROOT = Path(__file__).parents[2]
SHARED = Path(os.environ.get("GSGEN_SHARED", ROOT.parent / "shared"))


@dataclass(frozen=True, slots=True)
class Ran:
    """A finished command.

    Attributes:
        code: Its exit code.
        out: What it printed.
        err: Its trouble.
    """

    code: int
    out: str
    err: str


@dataclass(frozen=True, slots=True)
class MeasuredRun(Ran):
    """A finished command with what it used.

    Attributes:
        seconds: Processor time that it and its children took.
        peak_bytes: The largest resident size that it or one of its children had.
    """

    seconds: float
    peak_bytes: int


# A process starts with its parent's largest resident size as its own (`exec` in Linux carries
# it over), so the command's parent must be small: not the test process, but this program.
# It writes (exit code, processor time in s, peak in the system's unit) to the file argv[1].
_MEASURE_SCRIPT = """
import os, sys
process = os.posix_spawn(sys.executable, [sys.executable, *sys.argv[2:]], os.environ)
_, status, used = os.wait4(process, 0)
code = os.waitstatus_to_exitcode(status)
with open(sys.argv[1], "w") as record:
    print(code, used.ru_utime + used.ru_stime, used.ru_maxrss, file=record)
"""


def gsgen(*words: str | Path, cwd: Path | None = None, env: dict[str, str] | None = None) -> Ran:
    """Run the command line in a process of its own, as a user does."""
    completed = _run_python("-m", "gsgen.cli", *map(str, words), cwd=cwd, env=env)
    return Ran(completed.returncode, completed.stdout, completed.stderr)


def measured_gsgen(*words: str | Path) -> MeasuredRun:
    """Run the command line in a process of its own; measure its time and its memory."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "used"
        command = ["-m", "gsgen.cli", *map(str, words)]
        done = _run_python("-I", "-S", "-c", _MEASURE_SCRIPT, str(record), *command)
        assert done.returncode == 0, done.stderr
        code, seconds, peak = record.read_text().split()
    unit = 1 if sys.platform == "darwin" else 1024
    return MeasuredRun(int(code), done.stdout, done.stderr, float(seconds), int(peak) * unit)


def _run_python(
    *arguments: str, cwd: Path | None = None, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"COLUMNS": "200"} | (env or {}),
        timeout=300,
    )


def gsgen_here(
    *words: str | Path, cwd: Path | None = None, env: dict[str, str] | None = None
) -> Ran:
    """Run the command line in this process, which saves the second that a start takes.

    For tests of what a command does. Others start it as a user does: see :func:`gsgen`.
    """
    out, err, threshold = io.StringIO(), io.StringIO(), gc.get_threshold()
    environment = {"COLUMNS": "200"} | (env or {})
    with (
        patch.object(sys, "argv", ["gsgen", *map(str, words)]),
        patch.dict(os.environ, environment),
        chdir(cwd or Path.cwd()),
        redirect_stdout(out),
        redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    gc.set_threshold(*threshold)
    code = ended.value.code
    return Ran(
        code if isinstance(code, int) else int(code is not None), out.getvalue(), err.getvalue()
    )


def shared(relative: str) -> Path:
    """Return a shared data file, or skip the test where the data is absent."""
    path = SHARED / relative
    if not path.exists():
        pytest.skip(f"no shared data at {path} (set GSGEN_SHARED)")
    return path

"""What several test folders share: where data is, and how a user runs the program."""

import gc
import io
import os
import subprocess
import sys
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
        seconds: Processor time that it and its children took; 0 where that was not measured.
    """

    code: int
    out: str
    err: str
    seconds: float = 0.0


def gsgen(*words: str | Path, cwd: Path | None = None, env: dict[str, str] | None = None) -> Ran:
    """Run the command line in a process of its own, as a user does."""
    began = _children_seconds()
    done = subprocess.run(
        [sys.executable, "-m", "gsgen.cli", *map(str, words)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"COLUMNS": "200"} | (env or {}),
        timeout=300,
    )
    took = _children_seconds() - began
    return Ran(done.returncode, done.stdout, done.stderr, took)


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


def _children_seconds() -> float:
    if os.name == "nt":  # has no `resource`
        return 0.0
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def children_peak_bytes() -> int:
    """Return the largest resident size that any finished child process had."""
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * unit


def shared(relative: str) -> Path:
    """Return a shared data file, or skip the test where the data is absent."""
    path = SHARED / relative
    if not path.exists():
        pytest.skip(f"no shared data at {path} (set GSGEN_SHARED)")
    return path

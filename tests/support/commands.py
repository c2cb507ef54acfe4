"""What several test folders share: where data is, and how a user runs the program."""

import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHARED = Path(os.environ.get("GSGEN_SHARED", ROOT.parent / "shared"))


@dataclass(frozen=True, slots=True)
class Ran:
    """A finished command."""

    code: int
    out: str
    err: str
    seconds: float


def gsgen(
    *words: str | Path, cwd: Path | None = None, env: dict[str, str] | None = None
) -> Ran:
    """Run the command line in a process of its own, as a user does."""
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "gsgen.cli", *map(str, words)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"COLUMNS": "200"} | (env or {}),
        timeout=300,
    )
    return Ran(done.returncode, done.stdout, done.stderr, time.monotonic() - began)


def children_peak_bytes() -> int:
    """Return the largest resident size that any finished child process had."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024


def shared(relative: str) -> Path:
    """Return a shared data file, or skip the test where the data is absent."""
    path = SHARED / relative
    if not path.exists():
        pytest.skip(f"no shared data at {path} (set GSGEN_SHARED)")
    return path

"""Runs an action on a hostile file in a child process, and measures what came of it."""

__all__ = ["LIMIT_BYTES", "LIMIT_SECONDS", "Outcome", "run_forked"]

import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

LIMIT_SECONDS = 10
LIMIT_BYTES = 300_000_000
# A loaded machine may need more time on the clock than the processor works.
_WALL_SECONDS = 60
_MOST_LINES = 5  # the fault, the expected value, and hints


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of an action.

    Attributes:
        code: Its exit code; below zero for a signal.
        text: What it printed on both streams.
        seconds: Processor time of it and its children.
        peak_bytes: The largest resident size that it or one of its children had.
    """

    code: int
    text: str
    seconds: float
    peak_bytes: int

    def faults(self) -> list[str]:
        """Return why a hostile file was not handled well; empty if it was refused in a line."""
        lines = [line for line in self.text.splitlines() if line.strip()]
        checks = {
            f"ended by signal {-self.code}": self.code < 0,
            "accepted": self.code == 0,
            "internal error": self.code == 3,  # ExitCode.INTERNAL
            "traceback": "Traceback" in self.text,
            "silent": not lines,
            f"{len(lines)} lines": len(lines) > _MOST_LINES,
            f"{self.seconds:.1f} s": self.seconds > LIMIT_SECONDS,
            f"{self.peak_bytes / 1e6:.0f} MB": self.peak_bytes > LIMIT_BYTES,
        }
        return [name for name, is_fault in checks.items() if is_fault]


def run_forked(action: Callable[[], object], folder: Path | None = None) -> Outcome:
    """Run an action in a copy of this process, which has imported what it needs."""
    with tempfile.TemporaryFile() as output:
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if child == 0:
            _run_child(action, output.fileno(), folder)
        deadline = time.monotonic() + _WALL_SECONDS
        ended, status, used = os.wait4(child, os.WNOHANG)
        while not ended:
            if time.monotonic() > deadline:
                os.killpg(child, signal.SIGKILL)
                _, status, used = os.wait4(child, 0)
                break
            time.sleep(0.005)
            ended, status, used = os.wait4(child, os.WNOHANG)
        output.seek(0)
        text = output.read().decode("utf-8", errors="replace")
    return Outcome(
        code=os.waitstatus_to_exitcode(status),
        text=text,
        seconds=used.ru_utime + used.ru_stime,
        peak_bytes=used.ru_maxrss * (1 if sys.platform == "darwin" else 1024),
    )


def _run_child(action: Callable[[], object], output: int, folder: Path | None) -> None:
    """Run the action with its output in a file, and end the process."""
    code = 1
    try:
        os.setsid()
        for stream in (1, 2):
            os.dup2(output, stream)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        if folder is not None:
            os.chdir(folder)
        action()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 3
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

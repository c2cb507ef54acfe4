"""Seconds until a command ends at a signal, and what it leaves: python tests/bench/bench_endings.py.

Bars: exit code 128 + the signal's number, at most 2.7 s, no child process and no draft left.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.models.endless import endless

_MAX_SECONDS = 2.7
_START_SECONDS = 8.0  # until a command computes, on a busy machine, too
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def _measure(words: Sequence[str | Path], number: signal.Signals, drafts: Path) -> bool:
    """Print what one command does at one signal, and return whether it meets the bars."""
    command = [sys.executable, "-m", "gsgen.cli", *map(str, words)]
    environment = os.environ | {"TMPDIR": str(drafts)}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as running:
        time.sleep(_START_SECONDS)
        assert running.poll() is None, running.communicate()
        start = time.monotonic()
        running.send_signal(number)
        message = running.communicate(timeout=60)[1]
        seconds = time.monotonic() - start
    time.sleep(1)  # a child looks for its parent twice a second
    children = _processes_of(str(drafts))
    left = [path.name for path in drafts.glob("gsgen-*")]
    is_met = (
        running.returncode == 128 + number
        and seconds <= _MAX_SECONDS
        and not (children or left or "Traceback" in message)
    )
    name = " ".join(map(str, words[:2])) if words[0] == "tiles" else words[0]
    print(
        f"{name:<12} {number.name:<8} code {running.returncode:>3}  {seconds:5.2f} s  "
        f"{children} children  {len(left)} drafts  {'ok' if is_met else 'NOT MET'}",
        flush=True,
    )
    return is_met


def _processes_of(folder: str) -> int:
    """Return how many processes have a temporary folder (TMPDIR)."""
    count = 0
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment = (process / "environ").read_bytes()
        except OSError:  # it has ended, or belongs to another user
            continue
        count += f"TMPDIR={folder}".encode() in environment.split(b"\0")
    return count


def main() -> int:
    """Measure all commands, and return 1 if one misses a bar."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = endless(folder, 0.5)
        shutil.copy(model, folder / "second.onnx")
        drafts = folder / "drafts"
        drafts.mkdir()
        output = folder / "out"
        size = ("--width", "32", "--height", "32", "--frames", "3")
        commands: list[tuple[str | Path, ...]] = [
            ("validate", model),
            ("validate", model, folder / "second.onnx", "--jobs", "2"),
            ("render", model, "-o", output / "film.gif", *size),
            ("render", model, "-o", output / "film.gif", *size, "--trust"),
            ("tiles", "serve", folder),
        ]
        met = [_measure(words, number, drafts) for words in commands for number in _SIGNALS]
        left = list(output.glob(".gsgen-*"))
        print(f"{sum(met)} of {len(met)} endings meet the bars; {len(left)} drafts beside outputs")
        return int(not all(met) or bool(left))


if __name__ == "__main__":
    sys.exit(main())

"""Ctrl-C ends a command within seconds, with 130, whatever it is in the middle of."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.contract.process.interrupts import ending_at_interrupts
from support.commands import gsgen_here
from support.models.endless import endless

TASKS = Path("/proc/self/task")
LONG_SECONDS = 100  # seconds that a test waits for what must happen within a few
BUSY_SECONDS = 0.3  # processor seconds of a thread that is not the first: a frame is being computed


@pytest.fixture(autouse=True)
def _interruptible() -> Iterator[None]:
    """Let commands hear of Ctrl-C where the tests themselves ignore it, as shells' `&` makes them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupted(*words: str | Path) -> tuple[int, str]:
    """Run a command until it computes, press Ctrl-C, and return its code and what it said."""
    with subprocess.Popen(
        [sys.executable, "-m", "gsgen.cli", *map(str, words)], stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            end = time.monotonic() + LONG_SECONDS
            while _of_a_thread(running.pid) < BUSY_SECONDS:
                assert running.poll() is None, running.communicate()
                assert time.monotonic() < end, "it never computed"
                time.sleep(0.05)
            running.send_signal(signal.SIGINT)
            message = running.communicate(timeout=LONG_SECONDS)[1]
        finally:
            running.kill()
    return running.returncode, message


def _of_a_thread(process: int) -> float:
    """Return the processor seconds of the busiest thread but the first, also of children."""
    used = [0.0]
    for task in Path(f"/proc/{process}/task").iterdir():
        if task.name != str(process):
            fields = (task / "stat").read_text().rpartition(")")[2].split()
            used.append((int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"))
        used += [_of_a_thread(int(child)) for child in (task / "children").read_text().split()]
    return max(used)


@pytest.mark.skipif(not TASKS.exists(), reason="what threads do is read from /proc")
@pytest.mark.parametrize("after", [-1.0, 0.5], ids=["while it opens", "in a later frame"])
@pytest.mark.parametrize("options", [(), ("--trust",)], ids=["confined", "trusted"])
def test_a_model_that_never_ends_is_ended(
    tmp_path: Path, after: float, options: tuple[str, ...]
) -> None:
    model = endless(tmp_path, after)
    film = tmp_path / "film.gif"
    code, message = interrupted("render", model, "-o", film, "--frames", "3", "--width", "32",
                             "--height", "32", *options)  # fmt: skip
    assert code == 130, message
    assert "Traceback" not in message
    assert "onnxruntime" not in message
    assert [path.name for path in tmp_path.iterdir()] == [model.name]


def test_a_thread_that_never_ends_does_not_keep_the_process() -> None:
    code = (
        "import threading, time\n"
        "from gsgen.contract.process.interrupts import ending_at_interrupts\n"
        "with ending_at_interrupts(0.2):\n"
        "    threading.Thread(target=time.sleep, args=(10_000,)).start()\n"
        "    print('waits', flush=True)\n"
        "    time.sleep(10_000)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as running:
        try:
            assert running.stdout is not None
            running.stdout.readline()
            running.send_signal(signal.SIGINT)
            assert running.wait(LONG_SECONDS) == 130
        finally:
            running.kill()


def test_a_loop_that_takes_the_interrupt_for_itself_does_not_hide_it() -> None:
    used: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: used.append(number))
    try:
        with ending_at_interrupts(10_000) as interrupts:
            os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert used == [signal.SIGINT]
    assert interrupts.requested.is_set()


def test_other_signals_are_not_handled() -> None:
    before = signal.signal(signal.SIGTERM, lambda *_: None)
    try:
        with ending_at_interrupts(10_000) as interrupts:
            os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not interrupts.requested.is_set()


def test_crash_exits_3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("gsgen.cli.commands.drawing.options.read_tracks", broken)
    (tmp_path / "dots.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "end_header\n0 0 1 9 9 9\n"
    )
    completed = gsgen_here("render", tmp_path / "dots.ply", "-o", tmp_path / "dots.png")
    assert completed.code == 3
    assert "ZeroDivisionError: by zero" in completed.err
    assert completed.err.strip().splitlines()[-1].startswith("gsgen: internal error")

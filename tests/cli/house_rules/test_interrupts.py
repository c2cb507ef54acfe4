"""Ctrl-C, SIGTERM and SIGHUP end a command within seconds, whatever it is in the middle of."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from gsgen.contract.process.interrupts import Terminated, end_on_interrupt
from support.commands import gsgen_here
from support.models.endless import endless

TASKS = Path("/proc/self/task")
LONG_SECONDS = 100  # seconds that a test waits for what must happen within a few
EXIT_CODES = {
    signal.Signals[name]: code
    for name, code in (("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129))
    if hasattr(signal, name)  # Windows has no SIGHUP
}
BUSY_SECONDS = 0.3  # processor seconds of a thread that is not the first: a frame is being computed


@pytest.fixture(autouse=True)
def _interruptible() -> Iterator[None]:
    """Let commands hear of Ctrl-C where the tests themselves ignore it, as shells' `&` makes them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupted(number: signal.Signals, *words: str | Path) -> tuple[int, str]:
    """Run a command until it computes, send a signal, and return its code and what it said."""
    with subprocess.Popen(
        [sys.executable, "-m", "gsgen.cli", *map(str, words)], stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            end = time.monotonic() + LONG_SECONDS
            while _of_a_thread(running.pid) < BUSY_SECONDS:
                assert running.poll() is None, running.communicate()
                assert time.monotonic() < end, "it never computed"
                time.sleep(0.05)
            running.send_signal(number)
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
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
@pytest.mark.parametrize("after", [-1.0, 0.5], ids=["while it opens", "in a later frame"])
@pytest.mark.parametrize("options", [(), ("--trust",)], ids=["confined", "trusted"])
def test_a_model_that_never_ends_is_ended(
    tmp_path: Path, number: signal.Signals, after: float, options: tuple[str, ...]
) -> None:
    model = endless(tmp_path, after)
    film = tmp_path / "film.gif"
    code, message = interrupted(number, "render", model, "-o", film, "--frames", "3", "--width", "32",
                             "--height", "32", *options)  # fmt: skip
    assert code == EXIT_CODES[number], message
    assert "Traceback" not in message
    assert "onnxruntime" not in message
    assert [path.name for path in tmp_path.iterdir()] == [model.name]


@pytest.mark.skipif(not TASKS.exists(), reason="the children of a process are read from /proc")
@pytest.mark.parametrize("number", EXIT_CODES, ids=lambda number: number.name)
@pytest.mark.parametrize("jobs", [1, 2])
def test_ended_validation_leaves_no_child_and_no_draft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, jobs: int
) -> None:
    models = [endless(tmp_path, 0.5), tmp_path / "copy.onnx"]
    shutil.copy(*models)
    drafts = tmp_path / "drafts"
    drafts.mkdir()
    monkeypatch.setenv("TMPDIR", str(drafts))
    words = [sys.executable, "-m", "gsgen.cli", "validate", *map(str, models), "--jobs", str(jobs)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as running:
        try:
            _wait_until(lambda: len(list(drafts.glob("gsgen-*/events.jsonl"))) == jobs)
            workers = _processes_naming(str(drafts))
            assert len(workers) == jobs
            running.send_signal(number)
            message = running.communicate(timeout=LONG_SECONDS)[1]
        finally:
            running.kill()
    assert (running.returncode, message) == (EXIT_CODES[number], "")
    assert not list(drafts.glob("gsgen-*"))
    _wait_until(lambda: not _processes_naming(str(drafts)))


def _processes_naming(word: str) -> list[str]:
    """Return the command lines of the running processes that hold a word."""
    lines = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile
            lines.append((process / "cmdline").read_text())
    return [line for line in lines if word in line]


def _wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LONG_SECONDS
    while not condition():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.02)


@pytest.mark.parametrize("number", EXIT_CODES, ids=lambda number: number.name)
def test_a_thread_that_never_ends_does_not_keep_the_process(number: signal.Signals) -> None:
    code = (
        "import threading, time\n"
        "from gsgen.contract.process.interrupts import end_on_interrupt\n"
        "with end_on_interrupt(0.2):\n"
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
            running.send_signal(number)
            assert running.wait(LONG_SECONDS) == EXIT_CODES[number]
        finally:
            running.kill()


@pytest.mark.parametrize("number", EXIT_CODES, ids=lambda number: number.name)
def test_a_loop_that_takes_the_interrupt_for_itself_does_not_hide_it(
    number: signal.Signals,
) -> None:
    used: list[int] = []
    before = signal.signal(number, lambda sent, _: used.append(sent))
    try:
        with end_on_interrupt(10_000) as interrupts:
            os.kill(os.getpid(), number)
    finally:
        signal.signal(number, before)
    assert used == [number]
    assert interrupts.requested.is_set()
    assert interrupts.exit_code == EXIT_CODES[number]


def test_second_signal_does_not_interrupt_the_cleanup() -> None:
    cleaned = []
    with end_on_interrupt(10_000):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except Terminated:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGHUP)
            cleaned.append("drafts")
    assert cleaned == ["drafts"]


def test_ignored_hang_up_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as `nohup` does
    try:
        with end_on_interrupt(10_000) as interrupts:
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert not interrupts.requested.is_set()


def test_end_by_the_timer_removes_drafts(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys, time\n"
        "from pathlib import Path\n"
        "from gsgen.contract.process.drafts import temporary_folder\n"
        "from gsgen.contract.process.interrupts import end_on_interrupt\n"
        "with end_on_interrupt(0.1), temporary_folder(Path(sys.argv[1])):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "    except KeyboardInterrupt:\n"
        "        time.sleep(10_000)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], timeout=LONG_SECONDS)
    assert done.returncode == 143
    assert not list(tmp_path.iterdir())


def test_other_signals_are_not_handled() -> None:
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    try:
        with end_on_interrupt(10_000) as interrupts:
            os.kill(os.getpid(), signal.SIGUSR1)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert not interrupts.requested.is_set()


def test_crash_exits_3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
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

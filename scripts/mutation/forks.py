"""Runs tests in forks, of a process that has collected all tests or has imported libraries alone.

Collecting takes half a minute, importing libraries some seconds, a fork a hundredth of one.
"""

import gc
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType
from typing import Any

from mutation.patching import Functions, index_functions, patch
from mutation.sampling import PACKAGES
from mutation.selection import parameter_words

_LIBRARIES = ("hypothesis", "jsonschema", "numpy", "onnx", "onnx_ir", "onnxscript", "pytest")
_LIBRARIES += ("rich", "scipy", "torch", "typer")
CPU_SECONDS = 75
"""The most processor time of one fork: a test that is running then hangs."""
ENOUGH_SECONDS = 25
"""No test starts after this processor time of a fork and its children."""
FILE_SECONDS = 10
"""The rest of a file is skipped after this processor time, so that other files have their turn."""
IDLE_SECONDS = 90
"""A fork without a second of processor time in this time hangs; a busy machine only slows it."""
WALL_SECONDS = 1500
SLOW_SECONDS = 25
"""Tests that are known to take longer do not run."""
Changes = list[tuple[CodeType, CodeType]]


@dataclass(slots=True)
class TestRun:
    """The end of a run of tests.

    Attributes:
        failure: Node id of the first test or file that failed; None without one.
        hung: Node id of the test that exceeded the time limit or ended the process.
        seconds: Processor time of each test that ended.
    """

    failure: str | None = None
    hung: str | None = None
    seconds: dict[str, float] = field(default_factory=dict)


class _Recorder:
    """A pytest plugin that writes a line of JSON to a pipe for every test and failure."""

    def __init__(self, pipe: int, known: dict[str, float], parameters: set[str]) -> None:
        self.pipe, self.known, self.parameters, self.began = pipe, known, parameters, 0.0
        self.seconds: Counter[str] = Counter()  # of the files

    def write(self, kind: str, node: str, seconds: float = 0) -> None:
        os.write(self.pipe, json.dumps([kind, node, seconds]).encode() + b"\n")

    def chosen(self, items: list[Any]) -> list[Any]:
        """Return the items but slow ones: those of the parameters first, then the quick ones."""
        bad = {name for name, seconds in self.known.items() if seconds == float("inf")}
        items = [item for item in items if item.nodeid.partition("[")[0] not in bad]
        times = {item.nodeid: self.known.get(item.nodeid, 0) for item in items}
        quick = [item for item in items if times[item.nodeid] <= SLOW_SECONDS]

        def rank(item: Any) -> tuple[bool, float]:
            others = self.parameters.isdisjoint(parameter_words(item.nodeid))
            return others, max(1, times[item.nodeid])

        return sorted(quick, key=rank)

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = self.chosen(items)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.began = _processor_time()
        self.write("start", nodeid)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        seconds = _processor_time() - self.began
        self.seconds[nodeid.partition("::")[0]] += seconds
        self.write("end", nodeid, seconds)

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.write("failed", report.nodeid)

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            self.write("failed", report.nodeid)

    def pytest_runtest_setup(self, item: Any) -> None:
        if _processor_time() > ENOUGH_SECONDS:
            item.session.shouldstop = "enough tests have run"
        if self.seconds[item.nodeid.partition("::")[0]] > FILE_SECONDS:
            import pytest

            pytest.skip("its file had its turn")


def _processor_time() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _forked(action: Callable[[int], None]) -> TestRun:
    """Run an action in a fork, and read what its recorder writes."""
    reader, writer = os.pipe()
    folder = tempfile.mkdtemp(prefix="gsgen-mutant-")
    process = os.fork()
    if process == 0:
        os.close(reader)
        try:
            _isolate(folder)
            action(writer)
        finally:
            os._exit(0)
    os.close(writer)
    lines = _lines(process, reader)
    shutil.rmtree(folder, ignore_errors=True)
    run, running = TestRun(), None
    for kind, node, seconds in map(json.loads, lines):
        if kind == "start":
            running = node
        elif kind == "failed":
            run.failure = run.failure or node
        elif kind == "end":
            running, run.seconds[node] = None, seconds
    run.hung = running if run.failure is None else None
    return run


def _isolate(folder: str) -> None:
    """Give a fork its own process group, temporary folder, streams and time limit."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 5))
    sink = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(sink, stream)
    os.environ |= {"TMPDIR": folder, "PYTEST_DEBUG_TEMPROOT": folder}
    tempfile.tempdir = None


def _lines(process: int, reader: int) -> list[bytes]:
    """Read the lines that a fork writes until it ends, idles, or its time is over."""
    os.set_blocking(reader, False)
    now = time.monotonic()
    end, idle, next_check, used, content, ended = now + WALL_SECONDS, now, now, 0.0, b"", False
    while not ended and now < min(end, idle + IDLE_SECONDS):
        time.sleep(0.01)
        now = time.monotonic()
        if now > next_check:
            next_check, total = now + 2, _session_time(process)
            if total >= used + 1:
                used, idle = total, now
        ended = bool(os.waitpid(process, os.WNOHANG)[0])
        with suppress(BlockingIOError):
            while part := os.read(reader, 65536):
                content += part
    with suppress(ProcessLookupError):  # and the children that it left
        os.killpg(process, signal.SIGKILL)
    if not ended:
        os.waitpid(process, 0)
    os.close(reader)
    return content.splitlines()


def _session_time(leader: int) -> float:
    """Return the processor time of all processes of a session, and of their ended children."""
    total = 0
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended since
            fields = file.read_text("utf-8").rpartition(")")[2].split()
            if int(fields[3]) == leader:
                total += sum(map(int, fields[11:15]))
    return total / os.sysconf("SC_CLK_TCK")


def _arguments(tests: Sequence[str]) -> list[str]:
    options = ["-x", "-q", "-s", "-p", "no:cacheprovider", "-p", "no:xdist"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # plugins are imported already
    return [*options, *tests]


def prepare(tree: Path) -> None:
    """Import the libraries that tests need, and set the process up for the tests of a tree."""
    roots = [str(tree / package) for package in PACKAGES]
    os.environ |= {"PYTHONPATH": os.pathsep.join(roots), "PYTHONDONTWRITEBYTECODE": "1"}
    os.environ["OMP_NUM_THREADS"] = "1"  # threads do not survive a fork
    sys.dont_write_bytecode = True
    sys.path[:0] = roots
    os.chdir(tree)
    for name in _LIBRARIES:
        import_module(name)
    from hypothesis import settings

    settings.register_profile("mutants", deadline=None, database=None, derandomize=True)
    settings.load_profile("mutants")
    gc.freeze()


class FreshTests:
    """Runs test files in forks of a process that has imported libraries, but none of the tree."""

    def __init__(self) -> None:
        context = get_context("fork")
        self._connection, remote = context.Pipe()
        self._process = context.Process(target=self._serve, args=(remote,), daemon=False)
        self._process.start()

    def run(self, tests: Sequence[str], known: dict[str, float], first: set[str]) -> TestRun:
        """Run test files until the first failure, tests with a parameter in ``first`` first."""
        self._connection.send((list(tests), known, first))
        run: TestRun = self._connection.recv()
        return run

    def close(self) -> None:
        """End the process."""
        self._connection.send(None)
        self._process.join()

    @staticmethod
    def _serve(connection: Connection) -> None:
        import pytest

        while (job := connection.recv()) is not None:
            tests, known, first = job

            def action(
                pipe: int, tests: list[str] = tests, known: Any = known, first: set[str] = first
            ) -> None:
                recorder = _Recorder(pipe, known, first)
                code = pytest.main(_arguments(tests), plugins=[recorder])
                if code not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
                    recorder.write("failed", tests[0])  # if nothing else failed: a conftest.py

            connection.send(_forked(action))


class CollectedTests:
    """Runs tests in forks of this process, which has collected those of all files."""

    def __init__(self, files: Sequence[str]) -> None:
        import pytest
        from _pytest.config import _prepareconfig

        config = _prepareconfig(_arguments(files))
        config._do_configure()
        self._session: Any = pytest.Session.from_config(config)
        config.hook.pytest_sessionstart(session=self._session)
        config.hook.pytest_collection(session=self._session)
        self._functions: Functions = index_functions(os.getcwd())
        gc.collect()
        gc.freeze()

    @property
    def node_ids(self) -> list[str]:
        """Node ids of all tests."""
        return [item.nodeid for item in self._session.items]

    def run(
        self,
        tests: Sequence[str],
        known: dict[str, float],
        changes: Changes,
        first: Set[str] = frozenset(),
    ) -> TestRun | None:
        """Run test files or node ids with changed functions; None if one cannot be changed."""
        functions = self._functions
        names = {(old.co_filename, old.co_qualname, old.co_firstlineno) for old, _ in changes}
        if not all(functions.get(name) for name in names):
            return None

        def action(pipe: int) -> None:
            import pytest

            patch(changes, functions)
            recorder = _Recorder(pipe, known, set(first))
            session = self._session
            session.config.pluginmanager.register(recorder)
            rank = {name: number for number, name in enumerate(tests)}
            items = [x for x in session.items if {x.nodeid, x.nodeid.partition("::")[0]} & {*rank}]
            items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], 0))
            session.items = recorder.chosen(items)
            with suppress(pytest.Session.Failed, pytest.Session.Interrupted):
                session.config.hook.pytest_runtestloop(session=session)

        return _forked(action)

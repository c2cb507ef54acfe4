"""Run test files in forks of a process that has imported the libraries they need.

Importing them takes seconds, a fork a hundredth of one. A fork imports gsgen itself, from the tree
that it is told, so that each tests its own code.
"""

import gc
import os
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

_LIBRARIES = ("hypothesis", "jsonschema", "numpy", "onnx", "pytest", "rich", "scipy", "typer")
_MORE = {"sdk": ("onnx_ir", "onnxscript", "torch"), "reference_plugins": ("onnx_ir", "torch")}
"""Libraries that the tests of some packages need, too."""
_KILLED_AT_COLLECTION = ""


@dataclass(frozen=True, slots=True)
class TestRun:
    """The end of a test run.

    Attributes:
        passed: Whether all tests passed.
        failure: Node id of the first test or file that failed; None without one.
        timed_out: Whether the run was stopped at its time limit.
    """

    passed: bool
    failure: str | None = None
    timed_out: bool = False


class _FirstFailure:
    """A pytest plugin that records the node id of the first failure."""

    def __init__(self) -> None:
        self.node: str | None = None

    def pytest_runtest_logreport(self, report: object) -> None:
        self._record(report)

    def pytest_collectreport(self, report: object) -> None:
        self._record(report)

    def _record(self, report: object) -> None:
        if self.node is None and getattr(report, "failed", False):
            self.node = str(getattr(report, "nodeid", _KILLED_AT_COLLECTION))


def preload(package: str) -> None:
    """Import the libraries that tests of a package need, so that forks have them."""
    for name in (*_LIBRARIES, *_MORE.get(package, ())):
        with suppress(ImportError):
            import_module(name)
    gc.freeze()


def run_forked(
    tests: Sequence[str], tree: Path, packages: Sequence[str], seconds: float
) -> TestRun:
    """Run tests in a fork until the first failure.

    Args:
        tests: Test files or node ids, relative to ``tree``.
        tree: Root of the tree whose code and tests run.
        packages: The tree's folders that hold code.
        seconds: Time limit.
    """
    reader, writer = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(reader)
        code = 70  # of a fork that failed before its tests
        try:
            code = _run(tests, tree, packages, writer)
        finally:
            os._exit(code)
    os.close(writer)
    status = _wait(process, seconds)
    with os.fdopen(reader, encoding="utf-8") as file:
        failure = file.read() or None
    if status is None:
        return TestRun(passed=False, timed_out=True)
    return TestRun(passed=status == 0, failure=failure)


def _wait(process: int, seconds: float) -> int | None:
    """Return the exit code of a fork, or None if it was stopped at the time limit."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            with suppress(ProcessLookupError):  # children that it left
                os.killpg(process, signal.SIGKILL)
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    with suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return None


def _run(tests: Sequence[str], tree: Path, packages: Sequence[str], writer: int) -> int:
    """Run pytest in this process, write the first failure to a pipe, and return the exit code."""
    import pytest

    os.setsid()  # the time limit ends the children of tests, too
    sink = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(sink, stream)
    os.chdir(tree)
    roots = [str(tree / package) for package in packages]
    sys.path[:0] = roots
    os.environ |= {"PYTHONPATH": os.pathsep.join(roots), "PYTHONDONTWRITEBYTECODE": "1"}
    sys.dont_write_bytecode = True
    plugin = _FirstFailure()
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # plugins are imported already
    code = pytest.main([*options, *tests], plugins=[plugin])
    os.write(writer, (plugin.node or "").encode())
    return int(code)

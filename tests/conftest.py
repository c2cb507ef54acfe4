"""Which code is measured: tests of the contract, and commands that they run.

Measuring makes Python half as slow again, and costs every process a tenth of a second at its
start. Neither other rooms' tests are measured, nor long ones that run no further lines, nor pytest
itself, nor the thousand children that ONNX Runtime runs in, but for those of the command line's
own tests.
"""

import gc
import logging
import os
import pkgutil
import sys
import threading
from collections import Counter
from collections.abc import Generator, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from filelock import FileLock

from gsgen import cli, conformance, contract
from gsgen.contract.probing import sandbox
from support.forked_programs import program_folder
from support.forked_sandbox import run_forked
from support.reports import one_report
from support.reports.corpus_line import corpus_line

_ON = {name: value for name, value in os.environ.items() if name.startswith("COVERAGE_PROCESS")}

os.environ["GSGEN_NO_CACHE"] = "1"  # no test keeps what it measured of a driver
# Python's default of 700 spends an eighth of the run on looking at what was imported.
gc.set_threshold(20_000)


# These take longest: they start first, so that no worker is left with one of them at the end.
_SLOWEST = (
    "test_guides.py",
    "web",  # the folder
    "test_encodings.py",
    "test_site.py",
    "test_golden_exports.py",
    "test_avatar_exports.py",
    "test_corpus.py",
    "test_authored_modules.py",
    "test_rules.py",
    "test_wheel.py",
    "test_cache_machine.py",
    "test_models_as_tests.py",
    "test_cesium.py",
    "test_viewer_kit.py",
    "test_changes.py",
    "test_simulate.py",
    "test_neural_tiles.py",
    "test_demo.py",
    "test_helpers_export.py",
    "test_slabs.py",
    "test_weighted_slabs.py",
    "test_meshes.py",
    "test_denoiser.py",
    "test_five_mistakes.py",
    "test_robustness.py",
    "test_family_guide.py",
    "test_duplex_gs.py",
    "test_adversarial.py",
    "test_fuzz.py",
    "test_from_checkpoint_to_files.py",
    "test_other_commands.py",
    "test_difix.py",
    "test_session.py",
    "test_captured_models.py",
    "test_damaged_checkpoints.py",
    "test_plugin_template.py",
)
# The folders whose tests cover the contract, which has a least share of lines.
_MEASURED = ("cli/", "conformance/", "contract/")
# Long tests of the contract whose lines its other tests run, too, but for one in twenty.
_UNMEASURED = {
    "test_adversarial.py",
    "test_corpus.py",
    "test_five_mistakes.py",
    "test_good_models.py",
    "test_json_schema.py",
    "test_nasty_names.py",
    "test_rules_matter.py",
    "test_schema_check.py",
    "test_text_files.py",
    "test_upgrades_lossless.py",
    "test_value_rules.py",
}


@pytest.hookimpl(optionalhook=True)  # pytest-xdist need not be installed
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep a file's tests in one worker, and all that draw in a page: they share their kernels."""
    from xdist.scheduler import LoadFileScheduling

    class FileScheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            path = str(super()._split_scope(nodeid))
            return "tests/web" if path.startswith("tests/web/") else path

    return FileScheduling(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_configure(config: pytest.Config) -> None:
    if "PYTEST_XDIST_WORKER" in os.environ:  # started, and measured already
        config.pluginmanager.register(one_report)
        for name in _ON:
            os.environ.pop(name, None)
    if config.pluginmanager.is_blocked("logging"):  # which keeps messages out of stderr
        logging.getLogger().addHandler(logging.NullHandler())
    tracer = sys.gettrace()
    if type(tracer).__module__.startswith("coverage"):  # a debugger is left alone
        if not config.getoption("numprocesses", None):  # this process runs tests
            _import_measured_code()
        config.pluginmanager.register(_LineMeasurement(tracer, threading.gettrace()))


def _import_measured_code() -> None:
    """Import the contract, whose lines outside of functions run when it is imported."""
    for package in (cli, conformance, contract):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                import_module(module.name)


class _LineMeasurement:
    """Measures lines in fixtures and functions of the contract's tests, and not in pytest itself.

    ``tracer`` and ``thread_tracer`` are the functions of ``coverage``. They pause until the first
    fixture: neither the collection is measured nor the process that hands out the tests.
    """

    def __init__(self, tracer: Any, thread_tracer: Any) -> None:
        self._tracers = tracer, thread_tracer
        self._is_measured = False
        self._trace(None, None)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Note whether the lines of a test are measured."""
        name = item.path.relative_to(item.config.rootpath / "tests").as_posix()
        self._is_measured = name.startswith(_MEASURED) and item.path.name not in _UNMEASURED
        return (yield)

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_fixture_setup(self) -> Generator[None, object, object]:
        """Measure the lines of a fixture that a measured test needs first."""
        return (yield from self._measured())

    @pytest.hookimpl(wrapper=True, trylast=True)
    def pytest_pyfunc_call(self) -> Generator[None, object, object]:
        """Measure the lines of a test's function."""
        return (yield from self._measured())

    def _measured(self) -> Generator[None, object, object]:
        if not self._is_measured:
            return (yield)
        before = sys.gettrace(), threading.gettrace()
        self._trace(*self._tracers)
        try:
            return (yield)
        finally:
            self._trace(*before)  # a test that asks for a fixture goes on

    def _trace(self, tracer: Any, thread_tracer: Any) -> None:
        sys.settrace(tracer)
        threading.settrace(thread_tracer)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--slowest-files", type=int, default=0, help="Print the files whose tests took longest."
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: number for number, name in enumerate(_SLOWEST)}
    items.sort(
        key=lambda item: rank.get(item.path.name, rank.get(item.path.parent.name, len(rank)))
    )


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Collect in one worker after another: the first compiles the tests, and others load them."""
    if "PYTEST_XDIST_WORKER" not in os.environ or not hasattr(session.config, "cache"):
        return (yield)
    with FileLock(session.config.cache.mkdir("collection") / "lock"):
        return (yield)


def pytest_collection_finish() -> None:
    """Exempt imported modules and collected tests from garbage collection."""
    gc.freeze()


@pytest.fixture(autouse=True, scope="module")
def _measured(request: pytest.FixtureRequest) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if request.path.name in ("test_validate.py", "test_other_commands.py", "test_diff.py"):
            for name, value in _ON.items():
                patch.setenv(name, value)
        yield


@pytest.fixture(autouse=True, scope="module")
def _sandbox_children(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fork the sandbox's processes, but in the tests of the sandbox itself."""
    if sys.platform != "linux" or request.path.name == "test_sandbox.py":
        yield
        return
    with patch.object(sandbox, "_run_child", run_forked):
        yield


@pytest.fixture(scope="session")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of `gsgen`, `python` and `pytest` on a reader's PATH.

    Where there are forks, they are forked from one process which has imported their libraries.
    """
    if sys.platform != "linux":
        yield Path(sys.executable).parent
        return
    with program_folder(tmp_path_factory.mktemp("programs")) as folder:
        yield folder


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the size of the corpus, whether a rule failed out of turn, and the slowest files."""
    stats = terminalreporter.stats
    passed = [(report.nodeid, True) for report in stats.get("passed", ())]
    failed = [(report.nodeid, False) for report in stats.get("failed", ()) if report.when == "call"]
    line = corpus_line([*passed, *failed])
    if line:
        terminalreporter.write_line(f"corpus: {line}")
    seconds: Counter[str] = Counter()
    for report in (report for reports in stats.values() for report in reports):
        if isinstance(report, pytest.TestReport):
            seconds[report.nodeid.partition("::")[0]] += report.duration
    for name, total in seconds.most_common(terminalreporter.config.getoption("--slowest-files")):
        terminalreporter.write_line(f"{total:7.1f} s {name}")

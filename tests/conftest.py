"""Which processes are measured: test workers, and commands that a test of the command line runs.

Measuring costs every process a tenth of a second at its start. The thousand children that ONNX
Runtime runs in are not measured, but for those of the command line's own tests.
"""

import os

import pytest

from support.reports.corpus_line import corpus_line

_ON = {name: value for name, value in os.environ.items() if name.startswith("COVERAGE_PROCESS")}

os.environ["GSGEN_NO_CACHE"] = "1"  # no test keeps what it measured of a driver


def pytest_configure(config: pytest.Config) -> None:
    if "PYTEST_XDIST_WORKER" in os.environ:  # started, and measured already
        for name in _ON:
            os.environ.pop(name, None)


@pytest.fixture(autouse=True)
def _measured(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.node.path.name in ("test_validate.py", "test_other_commands.py", "test_diff.py"):
        for name, value in _ON.items():
            monkeypatch.setenv(name, value)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how large the corpus is that was judged, and whether any rule spoke out of turn."""
    stats = terminalreporter.stats
    passed = [(one.nodeid, True) for one in stats.get("passed", ())]
    failed = [(one.nodeid, False) for one in stats.get("failed", ()) if one.when == "call"]
    line = corpus_line([*passed, *failed])
    if line:
        terminalreporter.write_line(f"corpus: {line}")

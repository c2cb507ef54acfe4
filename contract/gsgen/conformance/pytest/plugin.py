"""The pytest plugin: `pytest --gsgen model.onnx` checks a model against each contract rule.

pytest loads this module in every run if gsgen is installed. So it only declares options; the code
that reads models is imported when an option names one.
"""

__all__: list[str] = []

import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gsgen.conformance.pytest.testing import Check

_MARKER_NAME = "gsgen_rules"
_CLASS_MODULE = "gsgen.conformance.pytest.generator"  # loaded if a test inherits from our class
_COLLECTED_SUFFIX = ".onnx"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the command-line options of the plugin; all of them start with ``--gsgen``."""
    group = parser.getgroup("gsgen", "conformance of Gaussian Generators")
    group.addoption(
        "--gsgen",
        action="append",
        default=[],
        metavar="MODEL",
        help="Test this ONNX file by the contract, one test a rule; repeatable. A folder or a glob "
        "names all in it.",
    )
    for name, metavar, text in _PYTEST_OPTIONS:
        group.addoption(f"--gsgen-{name}", metavar=metavar, help=text)
    group.addoption(
        "--gsgen-suite",
        action="append",
        default=[],
        metavar="SUITE",
        help="Only this suite: basic, camera, time, avatar, …; repeatable.",
    )


_PYTEST_OPTIONS = (
    ("target", "TARGET", "Target of the validation (default: core)."),
    (
        "level",
        "LEVEL",
        "Level of the validation: static, values, behaviour, … (default: behaviour).",
    ),
    ("fail-on", "SEVERITY", "Lowest severity that fails (default: error); others warn."),
    ("config", "FILE", "Configuration file (default: ./gsgen.toml, if it exists)."),
    ("xfails", "FILE", "TOML file of expected failures; one that holds fails too."),
    ("dump", "DIR", "Folder for inputs and outputs of failing probes (default: pytest's tmp)."),
)


def pytest_configure(config: pytest.Config) -> None:
    """Add models named with ``--gsgen`` to pytest's paths; without other paths, test only those."""
    config.addinivalue_line(
        "markers", f"{_MARKER_NAME}(request): give a test each rule of some models"
    )
    if not config.getoption("--gsgen"):
        return
    from gsgen.conformance.pytest.session import ConformanceSession
    from gsgen.contract.errors import ConfigInvalid
    from gsgen.contract.validator import expand_paths

    try:
        models = [str(path) for path in expand_paths(map(Path, config.getoption("--gsgen")))]
    except ConfigInvalid as error:
        raise pytest.UsageError(f"gsgen: --gsgen: {error}") from error
    config.option.gsgen = models

    ConformanceSession.from_config(config)  # a wrong option ends the run here
    if config.args_source is pytest.Config.ArgsSource.INVOCATION_DIR:
        config.args = []
    config.args += [model for model in models if model not in config.args]


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> "pytest.Collector | None":
    """Collect the ONNX files that ``--gsgen`` names."""
    if file_path.suffix != _COLLECTED_SUFFIX and not parent.config.getoption("--gsgen"):
        return None
    paths = {Path(name).resolve() for name in parent.config.getoption("--gsgen")}
    is_named_on_command_line = bool(paths) and parent.session.isinitpath(file_path)
    if file_path.resolve() not in paths and not (
        is_named_on_command_line and file_path.suffix == _COLLECTED_SUFFIX
    ):
        return None
    from gsgen.conformance.pytest.items import ModelFile

    return ModelFile.from_parent(parent, path=file_path)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Parametrize a test that has a ``check`` argument by the requested models and rules."""
    marker = metafunc.definition.get_closest_marker(_MARKER_NAME)
    if marker is not None:
        from gsgen.conformance.pytest.session import ConformanceSession
        from gsgen.conformance.pytest.testing import requested_checks

        conformance_session, folder = (
            ConformanceSession.from_config(metafunc.config),
            metafunc.definition.path.parent,
        )
        try:
            checks = requested_checks(marker.args[0], conformance_session, folder)
        except pytest.UsageError as error:  # stacks of pytest and gsgen do not show the mistake
            message = f"{metafunc.definition.nodeid}: {error}"
            raise pytest.fail.Exception(message, pytrace=False) from None
        metafunc.parametrize("check", checks, ids=[check.name for check in checks])


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(session: pytest.Session, items: "list[pytest.Item]") -> None:
    """Add a failing test for each expected failure that matches no tested validation rule."""
    if session.config.getoption("--gsgen-xfails"):
        from gsgen.conformance.pytest.items import stale_entries

        items += stale_entries(session)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Raise for a crashed validation rule, and skip tests of a model that cannot be validated."""
    if _CLASS_MODULE in sys.modules:
        from gsgen.conformance.pytest.skipped import skip_if_unusable

        skip_if_unusable(item)
    check = _find_check(item)
    if check is not None:
        from gsgen.conformance.pytest.session import report_properties

        item.user_properties += report_properties(check.run, check.case)
        check.fail_if_crashed()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Shorten pytest's failure report of a conformance test whose model cannot be validated."""
    report = yield
    if call.when == "setup" and report.failed and _CLASS_MODULE in sys.modules:
        from gsgen.conformance.pytest.skipped import record_unusable_model, uses_model

        if uses_model(item):
            record_unusable_model(item, call, report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Iterator[None]:
    """Fail a pytest test that requested a contract rule but never checked that rule."""
    result = yield
    check = _find_check(pyfuncitem)
    if check is not None and not check.is_called:
        pytest.fail(f"the test never called check(), so {check.name} was not checked")
    return result


def _find_check(item: pytest.Item) -> "Check | None":
    if item.get_closest_marker(_MARKER_NAME) is None or not isinstance(item, pytest.Function):
        return None
    parameter: Any = item.callspec.params["check"]
    check: Check = parameter
    return check

"""A pytest base class for tests of one ONNX model: every contract rule is a test."""

__all__ = ["GeneratorConformance"]

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from gsgen.conformance.expected import ExpectedFailure
from gsgen.conformance.pytest.session import (
    ConformanceSession,
    fail_if_crashed,
    raise_outcome,
    report_properties,
)
from gsgen.conformance.pytest.testing import refuse_unmatched_entries
from gsgen.conformance.run import ModelRun
from gsgen.conformance.suite import ALL_SUITES, Suite
from gsgen.contract.errors import GsgenError
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.fields.roles import GENERATOR, POST_PROCESS
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validation.settings import Settings

_UNTESTED_KINDS = (POST_PROCESS, "trajectory")


class GeneratorConformance:
    """Base class of pytest classes that test one model by rules; override the fixture ``model``.

    Such as::

        class TestDrift(GeneratorConformance):
            @pytest.fixture(scope="class")
            def model(self, tmp_path_factory):
                path = tmp_path_factory.mktemp("drift") / "drift.onnx"
                gsgen.sdk.exporting(Drift(), path)
                return path

    The fixtures ``target``, ``level``, ``expected_failures`` and ``settings`` may be overridden
    too. ``test_camera = None`` drops a whole suite.
    """

    @pytest.fixture
    def model(self) -> Path:
        """Pytest fixture: the path of the tested ONNX file; unchanged files are validated once."""
        pytest.fail(f"{type(self).__name__} must override the fixture `model`")

    @pytest.fixture
    def target(self) -> str | None:
        """Pytest fixture: the target runtime; None means the pytest option or gsgen's default."""
        return None

    @pytest.fixture
    def level(self) -> str | None:
        """Pytest fixture: the depth of validation; None means the pytest option or the default."""
        return None

    @pytest.fixture
    def settings(
        self, target: str | None, level: str | None, pytestconfig: pytest.Config
    ) -> Settings:
        """Pytest fixture: the settings of the validation."""
        return ConformanceSession.from_config(pytestconfig).make_settings(
            target=target, level=level
        )

    @pytest.fixture
    def expected_failures(self, pytestconfig: pytest.Config) -> Iterable[ExpectedFailure]:
        """Pytest fixture: rules that the model is known to break; an unexpected pass fails."""
        return ConformanceSession.from_config(pytestconfig).expected

    @pytest.fixture
    def conformance(
        self,
        model: Path,
        settings: Settings,
        expected_failures: Iterable[ExpectedFailure],
        pytestconfig: pytest.Config,
    ) -> ModelRun:
        """Pytest fixture: the results of validating the model."""
        pytest_session, path = ConformanceSession.from_config(pytestconfig), Path(model)
        expected = tuple(expected_failures)
        try:
            if expected != pytest_session.expected:  # entries of the options may name other models
                refuse_unmatched_entries(expected, {path: pytest_session.plan(path, settings)})
            return pytest_session.run(path, settings, expected)
        except (GsgenError, pytest.UsageError) as error:
            pytest.fail(f"{error}", pytrace=False)

    @pytest.fixture
    def _require_no_rule_crash(
        self, rule: Rule, conformance: ModelRun, request: pytest.FixtureRequest
    ) -> None:
        """Pytest fixture: reports a crashed rule as a test error instead of a test failure."""
        for case in conformance.cases:
            if case.rule.id == rule.id:
                request.node.user_properties += report_properties(conformance, case)
                fail_if_crashed(conformance, case)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Parametrize the test of each conformance suite by the validation rules of the suite."""
        rules = getattr(metafunc.function, "rules", None)
        if rules is not None:
            ids = [f"{rule.id}-{rule.slug}" for rule in rules]
            metafunc.parametrize("rule", rules, ids=ids)


def _suite_name(rule: Rule) -> str:
    """Return the name of the first suite that tests a rule, on a generator if the rule allows."""
    is_generator = GENERATOR in rule.kinds
    suites = [suite for suite in ALL_SUITES if not (is_generator and suite.name in _UNTESTED_KINDS)]
    return next(suite.name for suite in suites if suite.claims(rule))


def _make_suite_test(suite: Suite, rules: list[Rule]) -> Callable[..., None]:
    """Return a pytest function that tests one validation rule of a conformance suite on a model."""

    @pytest.mark.usefixtures("_require_no_rule_crash")
    def test(self: GeneratorConformance, rule: Rule, conformance: ModelRun) -> None:
        __tracebackhide__ = True
        try:
            case = conformance.case(rule.id)
        except KeyError:
            pytest.skip("not-applicable: for another target or kind of model")
        if suite.name not in conformance.suites and case.status == "passed":
            pytest.skip(f"not-applicable: suite {suite.name} is not for what it declares")
        raise_outcome(conformance, case)

    test.__doc__ = suite.summary
    test.__name__ = _test_name(suite)
    test.rules = rules  # type: ignore[attr-defined]
    return test


def _test_name(suite: Suite) -> str:
    return f"test_{suite.name.replace('-', '_')}"


def _add_tests() -> None:
    """Add a test method for each conformance suite to a class; subclasses can override it."""
    for suite in ALL_SUITES:
        rules = [r for r in installed_rules().rules.values() if _suite_name(r) == suite.name]
        if rules:
            setattr(GeneratorConformance, _test_name(suite), _make_suite_test(suite, rules))


_add_tests()

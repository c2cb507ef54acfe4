"""A base class for tests of one model: every rule is a test, and fixtures select the model."""

__all__ = ["GeneratorConformance"]

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from gsgen.conformance.expected import ExpectedFailure
from gsgen.conformance.pytest.session import ConformanceSession, act, prepare, properties
from gsgen.conformance.pytest.testing import refuse_strangers
from gsgen.conformance.run import ModelRun
from gsgen.conformance.suite import SUITES, Suite
from gsgen.contract.errors import GsgenError
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.roles import GENERATOR, POST_PROCESS
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validation.settings import Settings

_OTHER_KINDS = (POST_PROCESS, "trajectory")


class GeneratorConformance:
    """Tests of one model, rule by rule; inherit and override the fixture ``model``.

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
        """The ONNX file; a file is validated once as long as it is unchanged."""
        pytest.fail(f"{type(self).__name__} must override the fixture `model`")

    @pytest.fixture
    def target(self) -> str | None:
        """The target of the validation; None takes the option or the default."""
        return None

    @pytest.fixture
    def level(self) -> str | None:
        """The level of the validation; None takes the option or the default."""
        return None

    @pytest.fixture
    def settings(
        self, target: str | None, level: str | None, pytestconfig: pytest.Config
    ) -> Settings:
        """The settings of the validation."""
        return ConformanceSession.of(pytestconfig).make_settings(target=target, level=level)

    @pytest.fixture
    def expected_failures(self, pytestconfig: pytest.Config) -> Iterable[ExpectedFailure]:
        """The rules that the model is known to break; one that holds is a failure too."""
        return ConformanceSession.of(pytestconfig).expected

    @pytest.fixture
    def conformance(
        self,
        model: Path,
        settings: Settings,
        expected_failures: Iterable[ExpectedFailure],
        pytestconfig: pytest.Config,
    ) -> ModelRun:
        """The validation of the model."""
        bench, path = ConformanceSession.of(pytestconfig), Path(model)
        expected = tuple(expected_failures)
        try:
            if expected != bench.expected:  # entries of the options may name other models
                refuse_strangers(expected, {path: bench.plan(path, settings)})
            return bench.run(path, settings, expected)
        except (GsgenError, pytest.UsageError) as error:
            pytest.fail(f"{error}", pytrace=False)

    @pytest.fixture
    def _ready(self, rule: Rule, conformance: ModelRun, request: pytest.FixtureRequest) -> None:
        """Record the case of the rule; a crashed rule is an error, not a failure."""
        for case in conformance.cases:
            if case.rule.id == rule.id:
                request.node.user_properties += properties(conformance, case)
                prepare(conformance, case)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Parametrize the test of each suite by the rules of the suite."""
        rules = getattr(metafunc.function, "rules", None)
        if rules is not None:
            ids = [f"{rule.id}-{rule.slug}" for rule in rules]
            metafunc.parametrize("rule", rules, ids=ids)


def _home(rule: Rule) -> str:
    """Return the suite of a rule for a generator that declares all features."""
    is_generator = GENERATOR in rule.kinds
    suites = [suite for suite in SUITES if not (is_generator and suite.name in _OTHER_KINDS)]
    return next(suite.name for suite in suites if suite.claims(rule))


def _test_of(suite: Suite, rules: list[Rule]) -> Callable[..., None]:
    """Return the test function of a suite, which takes one of its rules."""

    @pytest.mark.usefixtures("_ready")
    def test(self: GeneratorConformance, rule: Rule, conformance: ModelRun) -> None:
        __tracebackhide__ = True
        try:
            case = conformance.case(rule.id)
        except KeyError:
            pytest.skip("not-applicable: for another target or kind of model")
        if suite.name not in conformance.suites and case.status == "passed":
            pytest.skip(f"not-applicable: suite {suite.name} is not for what it declares")
        act(conformance, case)

    test.__doc__ = suite.summary
    test.__name__ = _name(suite)
    test.rules = rules  # type: ignore[attr-defined]
    return test


def _name(suite: Suite) -> str:
    return f"test_{suite.name.replace('-', '_')}"


def _add_tests() -> None:
    """Add a test for each suite to the class, so that an author can override or drop it."""
    for suite in SUITES:
        rules = [r for r in installed_rules().rules.values() if _home(r) == suite.name]
        if rules:
            setattr(GeneratorConformance, _name(suite), _test_of(suite, rules))


_add_tests()

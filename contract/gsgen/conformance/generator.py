"""A class to inherit from: every rule is a test, and fixtures say what is tested."""

__all__ = ["GeneratorConformance"]

from collections.abc import Iterable
from pathlib import Path

import pytest

from gsgen.conformance.bench import Bench, act, prepare, properties
from gsgen.conformance.expected import ExpectedFailure
from gsgen.conformance.run import ModelRun
from gsgen.conformance.suite import SUITES
from gsgen.conformance.testing import refuse_strangers
from gsgen.contract.config import Settings
from gsgen.contract.installed import installed_rules
from gsgen.contract.roles import GENERATOR, POST_PROCESS
from gsgen.contract.rule import Rule

_OTHER_KINDS = (POST_PROCESS, "trajectory")


class GeneratorConformance:
    """Tests of one model, rule by rule; inherit and override the fixture ``model``.

    Such as::

        class TestDrift(GeneratorConformance):
            @pytest.fixture(scope="class")
            def model(self, tmp_path_factory):
                path = tmp_path_factory.mktemp("drift") / "drift.onnx"
                gsgen.sdk.export(Drift(), path)
                return path

    The fixtures ``target``, ``level``, ``expected_failures`` and ``settings`` may be overridden
    too. A whole suite is left out by ``test_camera = None``.
    """

    @pytest.fixture
    def model(self) -> Path:
        """The ONNX file; it is judged once for as long as it is the same file."""
        pytest.fail(f"{type(self).__name__} must override the fixture `model`")

    @pytest.fixture
    def target(self) -> str | None:
        """The consumer to judge for; None takes the option or the default."""
        return None

    @pytest.fixture
    def level(self) -> str | None:
        """How far to go; None takes the option or the default."""
        return None

    @pytest.fixture
    def settings(
        self, target: str | None, level: str | None, pytestconfig: pytest.Config
    ) -> Settings:
        """Everything that steers the judgement."""
        return Bench.of(pytestconfig).make_settings(target=target, level=level)

    @pytest.fixture
    def expected_failures(self, pytestconfig: pytest.Config) -> Iterable[ExpectedFailure]:
        """Rules that the model is known to break, strict both ways."""
        return Bench.of(pytestconfig).expected

    @pytest.fixture
    def conformance(
        self,
        model: Path,
        settings: Settings,
        expected_failures: Iterable[ExpectedFailure],
        pytestconfig: pytest.Config,
    ) -> ModelRun:
        """The model, judged."""
        bench, expected = Bench.of(pytestconfig), tuple(expected_failures)
        if expected != bench.expected:  # those of the options may speak of other models
            refuse_strangers(expected, {model: bench.plan(model, settings)})
        return bench.run(Path(model), settings, expected)

    @pytest.fixture
    def _ready(
        self, rule: Rule, conformance: ModelRun, request: pytest.FixtureRequest
    ) -> None:
        """Note what came of the rule; one that crashed is an error, not a failure."""
        for case in conformance.cases:
            if case.rule.id == rule.id:
                request.node.user_properties += properties(conformance, case)
                prepare(conformance, case)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Give each suite's test the rules that the suite claims."""
        name = metafunc.function.__name__.removeprefix("test_").replace("_", "-")
        if name in {suite.name for suite in SUITES} and "rule" in metafunc.fixturenames:
            rules = [
                rule for rule in installed_rules().rules.values() if _home(rule) == name
            ]
            ids = [f"{rule.id}-{rule.slug}" for rule in rules]
            metafunc.parametrize("rule", rules, ids=ids)


def _home(rule: Rule) -> str:
    """Return the suite that a rule belongs to in a generator that declares everything."""
    ours = GENERATOR in rule.kinds
    suites = [suite for suite in SUITES if not (ours and suite.name in _OTHER_KINDS)]
    return next(suite.name for suite in suites if suite.claims(rule))


def _test_of(suite: str, summary: str) -> object:
    @pytest.mark.usefixtures("_ready")
    def test(self: GeneratorConformance, rule: Rule, conformance: ModelRun) -> None:
        __tracebackhide__ = True
        try:
            case = conformance.case(rule.id)
        except KeyError:
            pytest.skip("not-applicable: not for this kind of model, or for another target")
        if suite not in conformance.suites and case.status == "passed":
            pytest.skip(
                f"not-applicable: suite {suite} is not for what this model declares"
            )
        act(conformance, case)

    test.__doc__ = summary
    test.__name__ = f"test_{suite.replace('-', '_')}"
    return test


for _suite in SUITES:
    setattr(
        GeneratorConformance,
        f"test_{_suite.name.replace('-', '_')}",
        _test_of(_suite.name, _suite.summary),
    )

"""The corpus of fixtures and the rules prove each other."""

import subprocess
import sys
from collections.abc import Callable
from functools import cache

import pytest

from gsgen.conformance.fixtures import Fixture, example_model_of_rule, find, fixtures
from gsgen.contract.errors import UnknownName
from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Rule
from gsgen.contract.validator import validate
from gsgen.tiles.validation.rules import all_rules

CORPUS = fixtures()
VALID_FIXTURES = [fixture for fixture in CORPUS if not fixture.rule]
BROKEN = [fixture for fixture in CORPUS if fixture.rule]

Judge = Callable[[Fixture], Report]


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    """Validate each fixture once, however many tests ask for it."""

    @cache
    def judged(fixture: Fixture) -> Report:
        return validate(fixture.write(tmp_path_factory.mktemp("corpus")), fixture.settings)

    return judged


each_rule = pytest.mark.parametrize("rule", builtin_rules(), ids=lambda rule: rule.id)
each_fixture = pytest.mark.parametrize("fixture", CORPUS, ids=lambda fixture: fixture.name)
each_good = pytest.mark.parametrize("fixture", VALID_FIXTURES, ids=lambda fixture: fixture.name)
each_broken = pytest.mark.parametrize(
    "fixture", BROKEN, ids=lambda fixture: f"{fixture.rule}-{fixture.name}"
)


@each_broken
def test_a_broken_model_breaks_its_rule_and_no_other(fixture: Fixture, judge):
    report = judge(fixture)
    assert {finding.rule for finding in report.findings} == {fixture.rule}
    is_confirmed = any(
        finding.severity is Severity.ERROR and finding.certainty == "confirmed"
        for finding in report.findings
    )
    assert report.verdict == ("invalid" if is_confirmed else "conforms")


# Rules that compare one number with limits; other statistical rules weigh several.
PLOTTED_RULES = {"GB030", "GB031", "GB034", "GB035", "GV040", "GV041", "GV042", "GV043", "GV044", "GV047",
           "GV048", "GV049"}  # fmt: skip


@pytest.mark.parametrize(
    "fixture",
    [fixture for fixture in BROKEN if fixture.rule in PLOTTED_RULES],
    ids=lambda f: f.name,
)
def test_a_statistical_finding_has_its_number_beyond_the_limits(fixture: Fixture, judge):
    for finding in judge(fixture).findings:
        statistic = finding.statistic
        assert statistic is not None
        low, high = statistic.low, statistic.high
        is_low = low is not None and statistic.value < low
        assert is_low or (high is not None and statistic.value >= high), statistic


@each_good
def test_a_good_model_breaks_nothing(fixture: Fixture, judge):
    report = judge(fixture)
    assert report.findings == ()
    assert report.verdict == "conforms"
    assert all(level.ran for level in report.levels)


@each_fixture
def test_no_rule_crashes_or_stays_silent(fixture: Fixture, judge):
    for outcome in judge(fixture).outcomes:
        assert outcome.status != "crashed", outcome.reason
        settled = outcome.status == "pass" or outcome.rule.id == fixture.rule
        assert settled or outcome.reason, f"{outcome.rule.id} is {outcome.status}"


@each_rule
def test_a_rule_passes_on_some_good_model(rule: Rule, judge):
    outcomes = (judge(fixture).outcome(rule.id) for fixture in VALID_FIXTURES)
    assert any(outcome.status == "pass" and outcome.items for outcome in outcomes)


def test_there_are_enough_fixtures():
    assert len(VALID_FIXTURES) >= 25
    assert len(CORPUS) >= 110


@each_fixture
def test_a_fixture_is_described_small_and_always_the_same(fixture: Fixture, tmp_path):
    assert fixture.summary.endswith(".")
    first = fixture.write(tmp_path).read_bytes()
    assert len(first) < 2_000_000
    assert fixture.draw().build().SerializeToString() == first


def test_an_unknown_fixture_is_answered_with_the_nearest():
    with pytest.raises(UnknownName, match="'opacity_is_logits'"):
        find("opacity_is_logit")


@pytest.mark.parametrize("rule", all_rules().rules.values(), ids=lambda rule: rule.id)
def test_the_example_that_explain_names_is_found(rule: Rule):
    assert find(example_model_of_rule(rule.id)).rule == rule.id


def test_importing_the_corpus_does_not_load_onnx_runtime():
    code = "import sys, gsgen.conformance.fixtures; sys.exit('onnxruntime' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

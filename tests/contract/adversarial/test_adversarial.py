"""Measures the validator on the adversarial set.

Every fourth model is measured, and all of them in the nightly tests.
"""

import re
from pathlib import Path

import pytest

from contract.adversarial.case import Fault, RightModel, all_faults, all_right_models
from contract.adversarial.runner import Measurement, measure, summary, table

SPECIFICATION = Path(__file__).parents[3] / "docs" / "spec"
# The share of decidable faults that are refused with the right cause first.
BAR = 0.98
# The share of heuristic faults that a finding names.
HEURISTIC_BAR = 0.85


def sampled(cases: tuple[Fault, ...] | tuple[RightModel, ...], step: int) -> list:
    return sorted(cases, key=lambda case: case.name)[::step]


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(4, marks=pytest.mark.slow, id="every fourth"),
        pytest.param(1, marks=pytest.mark.nightly, id="all"),
    ],
)
def measurement(request: pytest.FixtureRequest) -> Measurement:
    decidable = tuple(case for case in all_faults() if case.decidable)
    heuristic = tuple(case for case in all_faults() if not case.decidable)
    faults = [*sampled(decidable, request.param), *sampled(heuristic, request.param)]
    return measure(faults, sampled(all_right_models(), request.param))


def test_the_set_is_as_large_and_as_varied_as_it_claims() -> None:
    faults, right = all_faults(), all_right_models()
    assert len(faults) >= 150
    assert len({case.family for case in faults}) >= 5
    assert len(right) >= 60
    assert len({case.tool for case in right}) >= 7
    kinds = {"surface", "hair", "cloud", "room", "avatar"}
    assert kinds <= {case.kind for case in right}
    assert {case.statistics for case in right} == {"trained", "synthetic"}


def test_every_fault_says_what_a_finding_should_name() -> None:
    for case in all_faults():
        assert case.cause, case.name
        assert case.mistake.endswith("."), case.name
        for expression in case.cause:
            assert not re.search(expression, ""), f"{case.name}: {expression} matches anything"


@pytest.mark.parametrize(
    "case", [case for case in all_faults() if case.decidable], ids=lambda c: c.name
)
def test_the_violated_sentence_is_in_the_specification(case) -> None:
    page = (SPECIFICATION / case.sentence.page).read_text("utf-8")
    assert " ".join(case.sentence.text.split()) in " ".join(page.split())


def test_models_load_and_pass_the_checker_where_they_claim_to(measurement: Measurement) -> None:
    broken = [
        broken_promise for model in measurement.models for broken_promise in model.broken_promises
    ]
    assert not broken, "\n".join(broken)


def test_no_rule_crashes(measurement: Measurement) -> None:
    crashed = [model.name for model in measurement.models if model.verdict == "internal-error"]
    assert not crashed


def test_no_right_model_is_refused(measurement: Measurement) -> None:
    refused = [(m.name, m.errors) for m in measurement.of("right") if m.refused or m.errors]
    assert not refused


def test_right_models_earn_no_warning_but_those_they_are_made_for(measurement: Measurement) -> None:
    """With the next test, this bounds the warnings of the whole set, whatever the sample is."""
    declared = {case.name: list(case.warnings) for case in all_right_models()}
    earned = {model.name: model.warnings for model in measurement.of("right")}
    assert earned == {name: declared[name] for name in earned}


def test_right_models_expect_few_warnings() -> None:
    right = all_right_models()
    assert sum(len(case.warnings) for case in right) <= len(right) / 20


def test_decidable_faults_are_refused_with_the_right_cause_first(measurement: Measurement) -> None:
    counts = summary(measurement)
    right_cause, decidable = "decidable_refused_with_right_cause_first", counts["decidable"]
    missed_models = [
        m.name for m in measurement.of("decidable") if not (m.refused and m.cause_first)
    ]
    assert counts[right_cause] >= BAR * decidable, missed_models


def test_heuristic_faults_are_named(
    measurement: Measurement, capsys: pytest.CaptureFixture[str]
) -> None:
    with capsys.disabled():
        print("\n" + table(measurement))
    counts = summary(measurement)
    assert counts["heuristic_named"] >= HEURISTIC_BAR * counts["heuristic"]

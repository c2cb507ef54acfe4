from datetime import date
from pathlib import Path

import pytest

from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Finding, Location
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validation.waivers import Waiver, apply_waivers
from gsgen.contract.validator import validate
from support.models.small_models import good_rows, save_moving

TODAY = date(2026, 6, 1)
FINDING = Finding(
    rule="GV003",
    slug="s",
    severity=Severity.ERROR,
    where=Location("output g", "opacity"),
    message="nine",
    hint="hint",
    count=1,
    total=1,
)


@pytest.mark.parametrize(
    ("rule", "where", "covers"),
    [
        ("GV003", "", True),
        ("GV003", "output g", True),
        ("GV003", "output g, opacity", True),
        ("GV003", "output", False),
        ("GV003", "output h", False),
        ("GV003", "output g, position", False),
        ("GV004", "", False),
    ],
)
def test_a_waiver_covers_findings_of_its_rule_at_its_place(rule, where, covers):
    waiver = Waiver(rule=rule, reason="Known.", where=where)
    (finding,) = apply_waivers([FINDING], [waiver], TODAY)
    assert waiver.is_waiver_of(FINDING) is covers
    assert (finding.waived, finding.waiver) == (covers, "Known." if covers else "")


@pytest.mark.parametrize(
    ("last_day", "holds"), [(None, True), (date(2026, 6, 1), True), (date(2026, 5, 31), False)]
)
def test_a_waiver_holds_on_its_last_day_and_not_after(last_day, holds):
    (finding,) = apply_waivers(
        [FINDING], [Waiver(rule="GV003", reason="Known.", until=last_day)], TODAY
    )
    assert finding.waived is holds


@pytest.mark.parametrize(
    ("model", "is_applicable"),
    [
        ("", True),
        ("a.onnx", True),
        ("*.onnx", True),
        ("m/a.onnx", True),
        ("m/*", True),
        ("b.onnx", False),
        ("n/a.onnx", False),
    ],
)
def test_waiver_applies_to_all_models_or_the_named_ones(model, is_applicable):
    settings = Settings(waivers=(Waiver(rule="GV003", reason="Known.", model=model),))
    assert bool(settings.for_model(Path("m/a.onnx")).waivers) is is_applicable


@pytest.fixture
def validate_with_waivers(tmp_path):
    """Judge a model whose opacities are 2, with waivers."""
    rows = good_rows(4)
    rows[:, 3] = 2
    path = save_moving(tmp_path / "a.onnx", rows)

    def judged(*waivers, level=Level.VALUES):
        settings = Settings(level=level, waivers=waivers, today=TODAY)
        return validate(path, settings)

    return judged


def rules_of(report):
    return [(finding.rule, finding.waived) for finding in report.findings]


def test_a_waived_finding_does_not_fail(validate_with_waivers):
    assert validate_with_waivers().verdict == "invalid"
    report = validate_with_waivers(Waiver(rule="GV003", reason="Known."))
    assert report.verdict == "conforms"
    assert rules_of(report) == [("GV003", True)]


def test_a_waiver_that_waives_nothing_is_a_finding(validate_with_waivers):
    report = validate_with_waivers(Waiver(rule="GV003", reason="Known.", where="output gaussian"))
    assert rules_of(report) == [("GV003", False), ("GW001", False)]
    assert report.findings[1].where == Location("waiver of GV003 at output gaussian")
    assert report.findings[1].message.startswith("no matching finding; expected ")


def test_a_waiver_that_has_ended_is_a_finding_and_waives_nothing(validate_with_waivers):
    report = validate_with_waivers(Waiver(rule="GV003", reason="Known.", until=date(2026, 5, 31)))
    assert rules_of(report) == [("GV003", False), ("GW001", False)]
    assert report.findings[1].message.startswith("expired on 2026-05-31; expected ")


def test_waiver_of_an_unchecked_rule_is_not_reported(validate_with_waivers):
    report = validate_with_waivers(Waiver(rule="GV003", reason="Known."), level=Level.STATIC)
    assert report.outcome("GV003").status == "skipped"
    assert rules_of(report) == []
    assert report.outcome("GW001").status == "pass"


def test_waiver_rules_can_be_waived(validate_with_waivers):
    unneeded_waiver = Waiver(rule="GV004", reason="For later.")
    report = validate_with_waivers(
        Waiver(rule="GV003", reason="Known."),
        unneeded_waiver,
        Waiver(rule="GW001", reason="I know."),
    )
    assert rules_of(report) == [("GV003", True), ("GW001", True)]

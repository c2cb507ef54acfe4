import warnings
from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target
from gsgen.contract.validation.finding import Location, Violation
from gsgen.contract.validation.outcomes import ResultCollector
from gsgen.contract.validation.report import Outcome
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from support.reports.rules import breaking, crashing, made_up

TARGET = Target(
    name="acme",
    version="2",
    summary="A test.",
    opset=(13, 20),
    ir=10,
    domains=frozenset(),
    limits={"rows": 5},
)


def board(*rules, kind="gaussian-generator", **settings):
    return ResultCollector(
        registry=Registry.from_rules(rules), settings=Settings(**settings), kind=kind
    )


def check_rules(results, *rules):
    for rule in rules:
        if results.is_ready(rule):
            results.check(rule, None)
            results.settle([rule], items=3)
    return results


def test_a_rule_that_finds_nothing_passes():
    rule = made_up("GV901")
    outcome = check_rules(board(rule), rule).outcomes["GV901"]
    assert (outcome.status, outcome.reason, outcome.items) == ("pass", "", 3)
    assert 0 <= outcome.milliseconds < 1000


def test_a_rule_that_finds_something_fails_with_a_finding():
    rule = made_up("GV901", breaking, severity=Severity.WARNING)
    results = check_rules(board(rule), rule)
    assert results.outcomes["GV901"].status == "fail"
    (finding,) = results.findings()
    assert (finding.rule, finding.slug) == ("GV901", "made-up-gv901")
    assert finding.severity == Severity.WARNING
    assert finding.where == Location("output g")
    assert finding.message == "nine; expected ten"
    assert finding.hint == "Make it so."
    assert (finding.count, finding.total, finding.certainty) == (1, 1, "confirmed")
    assert (finding.source, finding.waived) == ("contract", False)


def test_a_rule_that_raises_is_crashed_and_says_where():
    rule, other_rule = made_up("GV901", crashing), made_up("GV902")
    results = check_rules(board(rule, other_rule), rule, other_rule)
    crashed = results.outcomes["GV901"]
    assert crashed.status == "crashed"
    assert crashed.reason.endswith("ZeroDivisionError: no luck")
    assert "in crashing" in crashed.reason
    assert results.outcomes["GV902"].status == "pass"


def test_violations_before_a_crash_are_kept():
    def both(subject):
        yield from breaking(subject)
        yield from crashing(subject)

    rule = made_up("GV901", both)
    results = check_rules(board(rule), rule)
    assert results.outcomes["GV901"].status == "crashed"
    assert len(results.findings()) == 1


def test_rules_that_need_a_failed_rule_are_blocked_and_name_it():
    first = made_up("GV901", breaking)
    second, third = made_up("GV902", needs=("GV901",)), made_up("GV903", needs=("GV902",))
    results = check_rules(board(first, second, third), first, second, third)
    text = "because GV901 does not hold"
    for rule in (second, third):
        outcome = Outcome(rule=rule, status="not-applicable", reason=text, blocked_by="GV901")
        assert results.outcomes[rule.id] == outcome


@pytest.mark.parametrize("status", ["crashed", "skipped"])
def test_crashed_or_skipped_rule_blocks_dependents(status):
    first, second = made_up("GV901", crashing), made_up("GV902", needs=("GV901",))
    results = board(first, second)
    if status == "skipped":
        results.skip([first], "no time")
    else:
        check_rules(results, first)
    assert not results.is_ready(second)
    assert results.outcomes["GV902"].blocked_by == "GV901"


def test_blocked_rule_blocks_dependents():
    first, second = made_up("GV901"), made_up("GV902", needs=("GV901",))
    results = board(first, second)
    assert results.ready_rules([second]) == []
    assert results.outcomes["GV902"].blocked_by == "GV901"


def test_inapplicable_rule_blocks_nothing():
    first = made_up("GV901", breaking, target="another")
    second = made_up("GV902", needs=("GV901",))
    results = check_rules(board(first, second), first, second)
    assert results.outcomes["GV901"].status == "not-applicable"
    assert results.outcomes["GV902"].status == "pass"


@pytest.mark.parametrize(
    ("options", "kind", "reason"),
    [
        ({"target": "webgpu"}, "gaussian-generator", "only for target webgpu"),
        ({"limit": "bytes"}, "gaussian-generator", "target acme sets no limit bytes"),
        ({}, "post-process", "only for kind gaussian-generator"),
        ({"target": "acme"}, "gaussian-generator", None),
        ({"limit": "rows"}, "gaussian-generator", None),
        ({"kinds": ("gaussian-generator", "post-process")}, "post-process", None),
        ({}, "", None),
    ],
)
def test_a_rule_applies_to_its_target_limit_and_kind(options, kind, reason):
    rule = made_up("GV901", **options)
    results = board(rule, kind=kind, target=TARGET)
    assert results.ready_rules([rule]) == ([] if reason else [rule])
    assert results.outcomes == (
        {"GV901": Outcome(rule=rule, status="not-applicable", reason=reason)} if reason else {}
    )


def test_a_rule_is_judged_once():
    rule = made_up("GV901")
    results = check_rules(board(rule), rule)
    assert not results.is_ready(rule)
    results.skip([rule], "too late")
    results.settle([rule], items=99)
    assert results.outcomes["GV901"].items == 3


def test_violations_at_one_location_are_one_finding():
    def many(_):
        yield Violation.at("output a", "x", "y")
        yield Violation.at("output b", "x", "y")
        yield Violation.at("output a", "x", "y")

    rule = made_up("GV901", many)
    findings = check_rules(board(rule), rule).findings()
    assert [(finding.where.subject, finding.count) for finding in findings] == [
        ("output a", 2),
        ("output b", 1),
    ]


def test_more_than_twenty_places_are_counted_with_the_first():
    def many(_):
        for _ in range(2):
            for index in range(25):
                yield Violation.at(f"output {index}", "x", "y")

    rule = made_up("GV901", many)
    findings = check_rules(board(rule), rule).findings()
    assert len(findings) == 20
    assert [finding.count for finding in findings] == [12] + [2] * 19
    assert [finding.truncated for finding in findings] == [True] + [False] * 19


def test_findings_come_worst_first_then_in_order_of_the_catalogue():
    severities = [Severity.INFO, Severity.ERROR, Severity.WARNING, Severity.ERROR]
    rules = [
        made_up(f"GV90{index}", breaking, severity=severity)
        for index, severity in enumerate(severities)
    ]
    findings = check_rules(board(*rules), *rules).findings()
    assert [finding.rule for finding in findings] == ["GV901", "GV903", "GV902", "GV900"]


def test_what_runs_showed_stands_above_remarks_on_the_file_and_the_likely_first():
    def possible(_):
        yield Violation.at("a", "b", "c", certainty="possible")

    remark = made_up("GV901", breaking, severity=Severity.WARNING)
    guess = made_up("GV902", possible, severity=Severity.ERROR, level=Level.VALUES)
    sure = made_up("GV903", breaking, severity=Severity.WARNING, level=Level.VALUES)
    fault = made_up("GV904", breaking, severity=Severity.ERROR)
    rules = (remark, guess, sure, fault)
    findings = check_rules(board(*rules), *rules).findings()
    assert [finding.rule for finding in findings] == ["GV904", "GV903", "GV902", "GV901"]
    assert findings[2].severity is Severity.WARNING  # a guess alone makes no model invalid


def test_an_ignored_rule_is_found_but_waived():
    rule = made_up("GV901", breaking)
    (finding,) = check_rules(board(rule, ignore=frozenset({"GV901"})), rule).findings()
    assert finding.waived


def test_severities_from_the_settings_hold():
    rule = made_up("GV901", breaking)
    results = check_rules(board(rule, severities={"GV901": Severity.INFO}), rule)
    assert results.findings()[0].severity == Severity.INFO


@pytest.mark.parametrize("options", [{"target": "acme"}, {"limit": "rows"}])
def test_target_only_finding_names_the_target_as_source(options):
    rule = made_up("GV901", breaking, **options)
    assert check_rules(board(rule, target=TARGET), rule).findings()[0].source == "acme@2"


def test_a_severity_that_a_target_sets_comes_from_it():
    severities = {"GV901": Severity.WARNING}
    target = Target(
        name="acme",
        version="2",
        summary="A test.",
        opset=(13, 20),
        ir=10,
        domains=frozenset(),
        limits={},
        severities=severities,
    )
    rule = made_up("GV901", breaking)
    (finding,) = check_rules(board(rule, target=target), rule).findings()
    assert (finding.source, finding.severity) == ("acme@2", Severity.WARNING)


def test_rows_of_several_probes_add_up():
    def odd(chunk):
        is_invalid = chunk % 2 == 1
        yield Violation.rows(
            Location("output g"), is_invalid, chunk, "even", checked=len(is_invalid)
        )

    rule = made_up("GV901", odd, over="rows")
    results = board(rule)
    for probe in ("a", "b"):
        for start in (0, 4):
            assert results.check(rule, np.arange(start, start + 4), probe, start)
    results.settle([rule])
    (finding,) = results.findings()
    assert (finding.count, finding.total) == (8, 16)
    assert [(e.row, e.probe) for e in finding.examples] == [
        (1, "a"),
        (3, "a"),
        (5, "a"),
        (7, "a"),
        (1, "b"),
    ]


def test_arithmetic_on_a_models_numbers_does_not_warn():
    def overflow(_):
        extreme_values = np.array([np.finfo(np.float32).max, np.inf], np.float32)
        yield Violation.at(
            "output g", str(extreme_values * extreme_values - extreme_values), "something smaller"
        )

    rule = made_up("GV901", overflow)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert check_rules(board(rule), rule).outcomes["GV901"].status == "fail"


@pytest.mark.parametrize(("is_cause", "status"), [(True, "not-applicable"), (False, "fail")])
def test_a_consequence_is_withdrawn_where_its_cause_fails(is_cause, status):
    consequence = replace(made_up("GV901", breaking), explained_by=("GB902",))
    cause = made_up("GB902", breaking) if is_cause else made_up("GB902")
    results = check_rules(board(consequence, cause), consequence, cause)
    results.withdraw_consequences()
    assert results.outcomes["GV901"].status == status
    assert {finding.rule for finding in results.findings()} == {"GB902" if is_cause else "GV901"}
    if is_cause:
        assert results.outcomes["GV901"].reason == "because GB902 explains what it found"

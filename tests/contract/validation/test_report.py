from dataclasses import replace

import pytest

from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.finding import Finding, Location
from gsgen.contract.validation.report import Cause, Outcome, Report, exit_code
from support.reports.rules import made_up

RULE = made_up("GV901")


def finding(severity=Severity.ERROR, **changes):
    summary = Finding(
        rule="GV901",
        slug="s",
        severity=severity,
        where=Location("output g"),
        message="nine",
        hint="hint",
        count=1,
        total=1,
    )
    return replace(summary, **changes)


def report(*findings, statuses=("pass",), fail_on=Severity.ERROR):
    outcomes = tuple(Outcome(rule=RULE, status=status) for status in statuses)
    return Report(
        path="a.onnx",
        size=1,
        kind="gaussian-generator",
        name="a",
        contract="1.0",
        capacity=4,
        target=load_target("core"),
        level=Level.STATIC,
        fail_on=fail_on,
        findings=findings,
        outcomes=outcomes,
        levels=(),
    )


@pytest.mark.parametrize("fail_on", Severity)
@pytest.mark.parametrize("severity", Severity)
def test_findings_at_or_above_fail_on_make_a_model_invalid(severity, fail_on):
    verdict = report(finding(severity), fail_on=fail_on).verdict
    assert verdict == ("invalid" if severity >= fail_on else "conforms")


def test_without_findings_a_model_conforms():
    assert report().verdict == "conforms"


@pytest.mark.parametrize("changes", [{"waived": True}, {"known": True}, {"certainty": "possible"}])
def test_waived_known_or_possible_finding_never_fails(changes):
    assert report(finding(**changes), fail_on=Severity.INFO).verdict == "conforms"


@pytest.mark.parametrize("findings", [(), (finding(),)])
def test_a_crashed_rule_leaves_no_verdict(findings):
    summary = report(*findings, statuses=("pass", "crashed", "fail"))
    assert summary.verdict == "internal-error"


def test_counts_exclude_waived_or_known_findings():
    summary = report(finding(), finding(waived=True), finding(known=True), finding(Severity.INFO))
    assert [summary.count(severity) for severity in Severity] == [1, 0, 1]


def test_every_status_is_counted():
    summary = report(statuses=("pass", "pass", "skipped", "fail"))
    assert summary.statuses == {"pass": 2, "skipped": 1, "fail": 1}
    assert summary.statuses["crashed"] == 0


def test_an_outcome_is_found_by_its_rule():
    summary = report()
    assert summary.outcome("GV901") is summary.outcomes[0]
    with pytest.raises(KeyError, match="GV902"):
        summary.outcome("GV902")


def test_causes_are_rules_that_keep_others_from_being_judged():
    names = ("GV901", "GV902", "GV903", "GV904")
    first, second, third, fourth = (made_up(name) for name in names)
    root = Outcome(rule=second, status="fail")
    blocked = [
        Outcome(rule=outcome, status="not-applicable", reason="because", blocked_by="GV902")
        for outcome in (first, fourth)
    ]
    outcomes = (blocked[0], root, Outcome(rule=third, status="pass"), blocked[1])
    summary = replace(report(), outcomes=outcomes)
    assert summary.causes == (Cause(root, (first, fourth)),)
    assert report().causes == ()


GOOD, INVALID, CRASHED = report(), report(finding()), report(statuses=("crashed",))


@pytest.mark.parametrize(
    ("reports", "code"),
    [
        ([], 0),
        ([GOOD, GOOD], 0),
        ([GOOD, INVALID], 1),
        ([CRASHED, GOOD], 3),
        ([INVALID, CRASHED], 3),
    ],
)
def test_the_exit_code_is_that_of_the_worst_report(reports, code):
    assert exit_code(reports) == code

"""Test cases of the conformance suite: the outcome of one contract rule on one model.

Every front end (pytest, the command line) shows these cases, so that all report the same.
"""

__all__ = ["Case", "CaseStatus", "make_case"]

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

from gsgen.conformance.expected import ExpectedFailure
from gsgen.contract.reporters.text import finding_lines
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Rule

# `warned`: broken below the severity that fails. `expected`: broken, and listed as expected.
CaseStatus = Literal["passed", "warned", "expected", "skipped", "failed", "crashed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A test case: the outcome of one contract rule on one model.

    Attributes:
        rule: The rule.
        suite: The name of the suite that holds the rule.
        status: The result of the test.
        text: The findings as ``gsgen validate`` prints them, or the reason; empty if passed.
        findings: The findings, waived ones included.
    """

    rule: Rule
    suite: str
    status: CaseStatus
    text: str = ""
    findings: tuple[Finding, ...] = ()

    @property
    def name(self) -> str:
        """The id and the slug of the validation rule, such as ``GV003-opacity-range``."""
        return f"{self.rule.id}-{self.rule.slug}"

    @property
    def has_failed(self) -> bool:
        """Whether the model breaks the contract rule, including expected failures and warnings."""
        return bool(self.findings)


def make_case(
    report: Report, rule: Rule, suite: str, expected: Iterable[ExpectedFailure] = ()
) -> Case:
    """Return one rule's test case, from the model's validation report and expected failures."""
    path = PurePath(report.path)
    expected_failure = next((entry for entry in expected if entry.matches(rule.id, path)), None)
    outcome = report.outcome(rule.id)
    findings = tuple(finding for finding in report.findings if finding.rule == rule.id)
    if outcome.status == "crashed":
        text = f"{rule.id} crashed: this is a fault of the rule\n{outcome.reason}"
        return Case(rule=rule, suite=suite, status="crashed", text=text, findings=findings)
    if outcome.status in ("skipped", "not-applicable"):
        return Case(
            rule=rule, suite=suite, status="skipped", text=f"{outcome.status}: {outcome.reason}"
        )
    status, text = _status_and_text(report, findings, expected_failure)
    return Case(rule=rule, suite=suite, status=status, text=text, findings=findings)


def _status_and_text(
    report: Report, findings: tuple[Finding, ...], expected_failure: ExpectedFailure | None
) -> tuple[CaseStatus, str]:
    if not findings:
        if expected_failure is None:
            return "passed", ""
        return "failed", f"holds, but is expected to fail: remove the entry\n  {expected_failure}"
    text = _findings_text(findings)
    if expected_failure is not None:
        return "expected", f"{expected_failure}\n{text}"
    if any(report.fails_by(finding) for finding in findings):
        return "failed", text
    if not any(finding.counts for finding in findings):
        return "skipped", f"accepted by the settings ({report.settings})\n{text}"
    return "warned", text


def _findings_text(findings: tuple[Finding, ...]) -> str:
    """Return a rule's findings as text, in the format of `gsgen validate`."""
    counted_findings = [finding for finding in findings if finding.counts] or findings
    return "\n".join(line.text for line in finding_lines(counted_findings))

"""JUnit XML report for test runners: one suite per model and one test per validation rule.

A rule fails its test if it makes the model invalid. Other findings go to the test's output.
"""

__all__ = ["to_junit"]

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from gsgen.contract.reporters.summary import printable
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Entry, Outcome, Report, Unreadable

_JUNIT_COUNT_TAGS = ("failure", "error", "skipped")


def to_junit(entries: Sequence[Entry]) -> str:
    """Return all validation reports as one JUnit XML document."""
    root = Element("testsuites", name="gsgen")
    for entry in entries:
        suite = SubElement(root, "testsuite", name=printable(entry.path))
        if isinstance(entry, Unreadable):
            _add_unreadable_case(suite, entry)
        else:
            _fill_suite(suite, entry)
    for parent in (*root, root):
        _count(parent)
    indent(root)
    body = tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{body}'


def _count(parent: Element) -> None:
    """Set the numbers of tests, failures, errors and skips of the JUnit element ``parent``."""
    parent.set("tests", str(len(list(parent.iter("testcase")))))
    for tag in _JUNIT_COUNT_TAGS:
        name = tag if tag == "skipped" else f"{tag}s"
        parent.set(name, str(len(list(parent.iter(tag)))))


def _add_unreadable_case(suite: Element, entry: Unreadable) -> None:
    case = SubElement(suite, "testcase", classname=printable(entry.path), name="readable")
    error = SubElement(case, "error", message=printable(entry.error.message))
    error.set("type", type(entry.error).__name__)
    error.text = printable(str(entry.error), kept_chars="\n")


def _fill_suite(suite: Element, report: Report) -> None:
    if report.timed:
        suite.set("time", f"{report.seconds:.3f}")
    findings_by_rule: dict[str, list[Finding]] = {}
    for finding in report.findings:
        findings_by_rule.setdefault(finding.rule, []).append(finding)
    for outcome in report.outcomes:
        case = SubElement(suite, "testcase", classname=printable(report.path))
        case.set("name", f"{outcome.rule.id} {outcome.rule.slug}")
        if report.timed:
            case.set("time", f"{outcome.milliseconds / 1000:.6f}")
        _add_result(case, report, outcome, findings_by_rule.get(outcome.rule.id, []))


def _add_result(
    case: Element, report: Report, outcome: Outcome, findings: Sequence[Finding]
) -> None:
    if outcome.status == "crashed":
        last = outcome.reason.splitlines()[-1] if outcome.reason else ""
        error = SubElement(case, "error", message=printable(last), type="crashed")
        error.text = printable(outcome.reason, kept_chars="\n")
    elif outcome.status in ("skipped", "not-applicable"):
        reason = printable(f"{outcome.status}: {outcome.reason}")
        if outcome in report.unchecked:
            SubElement(case, "failure", message=reason, type="required")
        else:
            SubElement(case, "skipped", message=reason)
    failing_findings = [finding for finding in findings if report.fails_by(finding)]
    remaining = [finding for finding in findings if not report.fails_by(finding)]
    if failing_findings and outcome.status != "crashed":
        first = printable(f"{failing_findings[0].where}: {failing_findings[0].message}")
        failure = SubElement(case, "failure", message=first)
        failure.set("type", failing_findings[0].severity.word)
        failure.text = "\n\n".join(map(_finding_text, failing_findings))
    if remaining:
        SubElement(case, "system-out").text = "\n\n".join(map(_finding_text, remaining))


def _finding_text(finding: Finding) -> str:
    notes = ["possible"] if finding.certainty == "possible" else []
    notes += [f"waived: {finding.waiver or 'ignored'}"] if finding.waived else []
    notes += ["known"] if finding.known else []
    suffix = f" ({'; '.join(notes)})" if notes else ""
    text = f"{finding.severity.word}{suffix}: {finding.where}: {finding.message}"
    return printable(f"{text}\nhint: {finding.hint}", kept_chars="\n")

"""JSON validation report, which follows the published schema ``gsgen-report/1``."""

__all__ = ["SCHEMA", "finding_to_dict", "to_dict", "to_json"]

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from gsgen.contract._safe_text import for_json
from gsgen.contract.reporters.document import (
    SCHEMA,
    CauseEntry,
    Counts,
    Document,
    ExampleEntry,
    Fault,
    FindingEntry,
    GoneEntry,
    LevelEntry,
    RuleEntry,
    Stats,
    SubjectEntry,
    ToleranceEntry,
    Tool,
    UncheckedEntry,
    UnreadableDocument,
    WhereEntry,
)
from gsgen.contract.reporters.rule_pages import help_path
from gsgen.contract.spec.fields.json_schema import to_json as to_json_value
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.digest import rules_digest
from gsgen.contract.validation.finding import Example, Finding
from gsgen.contract.validation.report import (
    Cause,
    Entry,
    Outcome,
    Report,
    ResolvedFinding,
    Unreadable,
)
from gsgen.contract.validation.rule import Rule

_RULE_STATUSES = ("pass", "fail", "skipped", "not-applicable", "crashed")


def to_json(entries: Sequence[Entry]) -> str:
    """Return a validation report as a JSON object, or several as an object with ``reports``."""
    documents = [to_dict(entry) for entry in entries]
    document: Any = (
        documents[0] if len(documents) == 1 else {"schema": SCHEMA, "reports": documents}
    )
    return for_json(document)


def to_dict(entry: Entry) -> dict[str, Any]:
    """Convert a model's validation report, or the error of an unreadable file, to JSON types."""
    document = _unreadable_document(entry) if isinstance(entry, Unreadable) else document_of(entry)
    data: dict[str, Any] = to_json_value(document)
    return data


def finding_to_dict(finding: Finding, rule: Rule) -> dict[str, Any]:
    """Convert a finding of a validation rule to JSON types, as validation reports hold it."""
    data: dict[str, Any] = to_json_value(_finding_entry(finding, rule))
    return data


def document_of(report: Report) -> Document:
    """Convert a validation report to the dataclasses of the JSON report's schema."""
    rules = {outcome.rule.id: outcome.rule for outcome in report.outcomes}
    return Document(
        schema="gsgen-report/1",
        tool=Tool("gsgen", version("gsgen"), rules_digest(rules.values())),
        subject=_subject_entry(report),
        target=report.target.label,
        level=report.level.word,
        fail_on=_severity_name(report.fail_on),
        settings=report.settings,
        verdict=report.verdict,
        counts=_counts(report),
        levels=tuple(
            LevelEntry(
                level=entry.level.word,
                status="ran" if entry.ran else "skipped",
                reason=entry.reason or None,
                runs=entry.runs,
                seconds=round(entry.seconds, 4) if report.timed else None,
            )
            for entry in report.levels
        ),
        findings=tuple(_finding_entry(finding, rules[finding.rule]) for finding in report.findings),
        causes=tuple(_cause_entry(cause, report) for cause in report.causes),
        rules=tuple(_rule_entry(outcome, with_times=report.timed) for outcome in report.outcomes),
        tolerances=tuple(
            ToleranceEntry(tolerance.field, tolerance.value, tolerance.unit, tolerance.source)
            for tolerance in report.tolerances
        ),
        probes=report.probes,
        environment=report.environment,
        truncated=any(finding.truncated for finding in report.findings),
        seconds=round(report.seconds, 4) if report.timed else None,
        unchecked=tuple(
            UncheckedEntry(outcome.rule.id, outcome.status, outcome.reason)
            for outcome in report.unchecked
        ),
        moments=report.moments,
        not_checked=tuple(outcome.rule.id for outcome in report.not_checked),
        baseline=report.baseline or None,
        gone=tuple(_resolved_entry(finding) for finding in report.resolved)
        if report.baseline
        else None,
    )


def _unreadable_document(entry: Unreadable) -> UnreadableDocument:
    error = entry.error
    fault = Fault(error.message, error.where, error.hint)
    subject = SubjectEntry(uri=entry.path)
    return UnreadableDocument("gsgen-report/1", subject, "unreadable", fault)


def _subject_entry(report: Report) -> SubjectEntry:
    return SubjectEntry(
        uri=report.path,
        bytes=report.size,
        external_bytes=report.external_size or None,
        sha256=report.sha256 or None,
        kind=report.kind or None,
        name=report.name or None,
        contract=report.contract or None,
        capacity=report.capacity,
    )


def _counts(report: Report) -> Counts:
    return Counts(
        error=report.count(Severity.ERROR),
        warning=report.count(Severity.WARNING),
        info=report.count(Severity.INFO),
        waived=sum(finding.waived for finding in report.findings),
        known=sum(finding.known for finding in report.findings),
        rules={status: report.statuses[status] for status in _RULE_STATUSES},
    )


def _finding_entry(finding: Finding, rule: Rule) -> FindingEntry:
    return FindingEntry(
        rule=finding.rule,
        slug=finding.slug,
        severity=_severity_name(finding.severity),
        certainty=finding.certainty,
        where=WhereEntry(finding.where.subject, finding.where.field or None),
        message=finding.message,
        stats=Stats(
            finding.count,
            finding.total,
            tuple(_example_entry(example) for example in finding.examples),
            _example_entry(finding.worst) if finding.worst else None,
        ),
        why=rule.rationale,
        hint=finding.hint,
        source=finding.source,
        waived=finding.waived,
        known=finding.known,
        truncated=finding.truncated,
        fingerprint=finding.fingerprint,
        help=help_path(rule) or None,
        waiver=finding.waiver or None,
        evidence=rule.evidence or None,
    )


def _resolved_entry(finding: ResolvedFinding) -> GoneEntry:
    where = WhereEntry(finding.where.subject, finding.where.field or None)
    return GoneEntry(
        rule=finding.rule,
        slug=finding.slug,
        where=where,
        message=finding.message,
        fingerprint=finding.fingerprint,
    )


def _severity_name(severity: Severity) -> Any:
    return severity.word


def _example_entry(example: Example) -> ExampleEntry:
    return ExampleEntry(example.value, example.row, example.probe or None)


def _cause_entry(cause: Cause, report: Report) -> CauseEntry:
    id = cause.outcome.rule.id
    fingerprints = tuple(finding.fingerprint for finding in report.findings if finding.rule == id)
    blocked_ids = tuple(rule.id for rule in cause.blocked_rules)
    return CauseEntry(id, cause.outcome.status, fingerprints, blocked_ids)


def _rule_entry(outcome: Outcome, *, with_times: bool) -> RuleEntry:
    entry = RuleEntry(id=outcome.rule.id, status=outcome.status, reason=outcome.reason or None)
    if outcome.status not in ("pass", "fail"):
        return entry
    milliseconds = round(outcome.milliseconds, 3) if with_times else None
    return RuleEntry(
        id=entry.id, status=entry.status, reason=entry.reason, ms=milliseconds, items=outcome.items
    )

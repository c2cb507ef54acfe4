"""A report for programs: JSON, with the schema name ``gsgen-report/1``."""

__all__ = ["SCHEMA", "to_dict", "to_json"]

import json
from importlib.metadata import version
from typing import Any

from gsgen.contract.errors import GsgenError
from gsgen.contract.finding import Example, Finding, Severity
from gsgen.contract.report import Outcome, Report

SCHEMA = "gsgen-report/1"


def to_json(entries: list[Report | tuple[str, GsgenError]]) -> str:
    """Return one report as an object, or several as an object with a list of ``reports``.

    A model that could not be read stands as its path and the error.
    """
    made = [to_dict(e) if isinstance(e, Report) else _unreadable(*e) for e in entries]
    document: Any = made[0] if len(made) == 1 else {"schema": SCHEMA, "reports": made}
    return json.dumps(document, indent=2, ensure_ascii=False)


def to_dict(report: Report) -> dict[str, Any]:
    """Return a report as plain data."""
    return {
        "schema": SCHEMA,
        "tool": {"name": "gsgen", "version": version("gsgen")},
        "subject": {
            "uri": report.path,
            "bytes": report.size,
            "kind": report.kind or None,
            "name": report.name or None,
            "contract": report.contract or None,
            "capacity": report.capacity,
        },
        "target": report.target.label,
        "level": report.level.word,
        "fail_on": report.fail_on.word,
        "settings": report.settings,
        "verdict": report.verdict,
        "counts": _counts(report),
        "levels": [
            {"level": o.level.word, "status": "ran" if o.ran else "skipped"}
            | ({"reason": o.reason} if o.reason else {})
            for o in report.levels
        ],
        "findings": [_finding(finding) for finding in report.findings],
        "rules": [_outcome(outcome) for outcome in report.outcomes],
        "probes": list(report.probes),
        "environment": report.environment,
        "seconds": round(report.seconds, 4),
    }


def _unreadable(path: str, error: GsgenError) -> dict[str, Any]:
    detail = {"what": error.what, "where": error.where, "mend": error.mend}
    return {
        "schema": SCHEMA,
        "subject": {"uri": path},
        "verdict": "unreadable",
        "error": detail,
    }


def _counts(report: Report) -> dict[str, Any]:
    by_severity = {severity.word: report.count(severity) for severity in reversed(Severity)}
    waived = sum(finding.waived for finding in report.findings)
    statuses = ("pass", "fail", "skipped", "not-applicable", "crashed")
    rules = {status: report.statuses[status] for status in statuses}
    return {**by_severity, "waived": waived, "rules": rules}


def _finding(finding: Finding) -> dict[str, Any]:
    where = {"subject": finding.where.subject}
    if finding.where.field:
        where["field"] = finding.where.field
    return {
        "rule": finding.rule,
        "slug": finding.slug,
        "severity": finding.severity.word,
        "certainty": finding.certainty,
        "where": where,
        "message": finding.message,
        "stats": {
            "count": finding.count,
            "total": finding.total,
            "examples": [_example(example) for example in finding.examples],
            "worst": _example(finding.worst) if finding.worst else None,
        },
        "mend": finding.mend,
        "source": finding.source,
        "waived": finding.waived,
    }


def _example(example: Example) -> dict[str, Any]:
    made: dict[str, Any] = {"value": example.value}
    if example.row is not None:
        made["row"] = example.row
    if example.probe:
        made["probe"] = example.probe
    return made


def _outcome(outcome: Outcome) -> dict[str, Any]:
    made: dict[str, Any] = {"id": outcome.rule.id, "status": outcome.status}
    if outcome.reason:
        made["reason"] = outcome.reason
    if outcome.status in ("pass", "fail"):
        made |= {"ms": round(outcome.milliseconds, 3), "items": outcome.items}
    return made

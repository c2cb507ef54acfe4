"""A report for code scanning: SARIF 2.1.0, one run for all models.

Rules are described from their declarations. A model is binary, so a result's place in it is a
logical location, such as ``output gaussians``, and every result points at line 1 of the file:
some readers turn away results without a line.
"""

__all__ = ["to_sarif"]

import json
import os
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from gsgen.contract.reporters.summary import printable
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Entry, Report, Unreadable
from gsgen.contract.validation.rule import Rule

_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "note"}
# What a result's fingerprint is called; a change in how it is made needs another name.
_FINGERPRINT = "gsgen/1"

Json = dict[str, Any]


def to_sarif(entries: Sequence[Entry]) -> str:
    """Return all reports as one SARIF log."""
    reports = {
        number: entry for number, entry in enumerate(entries) if isinstance(entry, Report)
    }
    rules = {
        one.rule.id: one.rule for report in reports.values() for one in report.outcomes
    }
    numbers = {id: number for number, id in enumerate(rules)}
    driver = {
        "name": "gsgen",
        "version": version("gsgen"),
        "rules": [_rule(rule) for rule in rules.values()],
    }
    results = [
        _result(report, finding, numbers[finding.rule], number)
        for number, report in reports.items()
        for finding in report.findings
    ]
    run = {
        "tool": {"driver": driver},
        "artifacts": [_artifact(entry) for entry in entries],
        "invocations": [_invocation(entries)],
        "results": results,
    }
    log = {"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}
    return json.dumps(log, indent=2)  # in ASCII: a path may hold what UTF-8 cannot


def _rule(rule: Rule) -> Json:
    return {
        "id": rule.id,
        "name": "".join(word.capitalize() for word in rule.slug.split("-")),
        "shortDescription": {"text": rule.statement},
        "fullDescription": {"text": rule.why},
        "help": {"text": f"{rule.why}\n\nHow to mend it: {rule.hint}"},
        "defaultConfiguration": {"level": _LEVELS[rule.severity]},
        "properties": {
            "slug": rule.slug,
            "level": rule.level.word,
            "tags": [rule.family, rule.level.word, *([rule.target] if rule.target else [])],
        },
    }


def _artifact(entry: Entry) -> Json:
    made: Json = {"location": {"uri": _uri(entry.path)}, "roles": ["analysisTarget"]}
    if isinstance(entry, Report):
        made["length"] = entry.size
        made |= {"hashes": {"sha-256": entry.sha256}} if entry.sha256 else {}
    return made


def _uri(path: str) -> str:
    """Return a URI reference: relative for a relative path, so that it holds on any machine."""
    quoted = quote(os.fsencode(Path(path).as_posix()))
    return f"file://{quoted}" if Path(path).is_absolute() else quoted


def _invocation(entries: Iterable[Entry]) -> Json:
    troubles = [
        trouble
        for number, entry in enumerate(entries)
        for trouble in _troubles(entry, number)
    ]
    return {
        "executionSuccessful": not troubles,
        "toolExecutionNotifications": troubles,
    }


def _troubles(entry: Entry, number: int) -> list[Json]:
    """Say what was not judged though it should have been: an unreadable file, a crashed rule."""
    if isinstance(entry, Unreadable):
        return [_trouble(entry.path, number, str(entry.error))]
    return [
        _trouble(entry.path, number, f"{one.rule.id} crashed: {one.reason}", one.rule)
        for one in entry.outcomes
        if one.status == "crashed"
    ]


def _trouble(path: str, number: int, text: str, rule: Rule | None = None) -> Json:
    made: Json = {
        "level": "error",
        "message": {"text": printable(text, keep="\n")},
        "locations": [{"physicalLocation": _place(path, number)}],
    }
    return made | ({"associatedRule": {"id": rule.id}} if rule else {})


def _place(path: str, number: int) -> Json:
    return {
        "artifactLocation": {"uri": _uri(path), "index": number},
        "region": {"startLine": 1},
    }


def _result(report: Report, finding: Finding, rule: int, number: int) -> Json:
    level = _LEVELS[finding.severity]
    if finding.certainty == "possible" and level == "error":
        level = "warning"  # a guess from the numbers fails nobody
    made: Json = {
        "ruleId": finding.rule,
        "ruleIndex": rule,
        "kind": "fail",
        "level": level,
        "message": {"text": printable(f"{finding.where}: {finding.message}")},
        "locations": [
            {
                "physicalLocation": _place(report.path, number),
                "logicalLocations": [_logical(finding)],
            }
        ],
        "partialFingerprints": {_FINGERPRINT: finding.fingerprint},
        "properties": {
            "certainty": finding.certainty,
            "count": finding.count,
            "total": finding.total,
            "hint": finding.hint,
            "source": finding.source,
        },
    }
    if report.baseline:
        made["baselineState"] = "unchanged" if finding.known else "new"
    return made | {"suppressions": _suppressions(finding)}


def _logical(finding: Finding) -> Json:
    kind, _, name = finding.where.subject.partition(" ")
    return {
        "name": printable(finding.where.field or name or kind),
        "fullyQualifiedName": printable(str(finding.where)),
        "kind": "variable" if kind in ("input", "output") else "member",
    }


def _suppressions(finding: Finding) -> list[Json]:
    if not finding.waived:
        return []
    reason = finding.waiver or f"{finding.rule} is ignored by the settings"
    return [{"kind": "external", "status": "accepted", "justification": reason}]

"""SARIF 2.1.0 report for code scanning, with one run for all models.

A model is binary, so a result has a logical location, such as ``output gaussians``, and every
result points at line 1 of the file: some readers reject results without a line.
"""

__all__ = ["to_sarif"]

import os
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from gsgen.contract._safe_text import for_json, printable
from gsgen.contract.reporters.rule_pages import help_url
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Entry, Outcome, Report, Unreadable
from gsgen.contract.validation.rule import Rule

_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
_SARIF_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "note"}
# The name of the fingerprint; another way to compute it needs another name.
_FINGERPRINT_KEY = "gsgen/1"

Json = dict[str, Any]


def to_sarif(entries: Sequence[Entry]) -> str:
    """Return all validation reports as one SARIF log."""
    reports = {number: entry for number, entry in enumerate(entries) if isinstance(entry, Report)}
    rules = {
        outcome.rule.id: outcome.rule
        for report in reports.values()
        for outcome in report.outcomes
        if outcome.rule.id in _rules_of_findings(report)
    }
    docs_url = next((report.docs_url for report in reports.values()), "")
    numbers = {id: number for number, id in enumerate(rules)}
    driver = {
        "name": "gsgen",
        "version": version("gsgen"),
        "rules": [_sarif_rule(rule, docs_url) for rule in rules.values()],
    }
    results = [
        _result_entry(report, finding, numbers[finding.rule], number)
        for number, report in reports.items()
        for finding in report.findings
    ]
    run = {
        "tool": {"driver": driver},
        "artifacts": [_artifact_entry(entry) for entry in entries],
        "invocations": [_invocation_entry(entries)],
        "results": results,
    }
    log = {"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}
    return for_json(log)


def _rules_of_findings(report: Report) -> set[str]:
    """Return the ids of the rules that a SARIF log refers to."""
    silent_failures = [*_crashed_outcomes(report), *report.unchecked]
    rules_of_findings = {finding.rule for finding in report.findings}
    return rules_of_findings | {outcome.rule.id for outcome in silent_failures}


def _crashed_outcomes(report: Report) -> list[Outcome]:
    return [outcome for outcome in report.outcomes if outcome.status == "crashed"]


def _sarif_rule(rule: Rule, docs_url: str) -> Json:
    url = help_url(rule, docs_url)
    return ({"helpUri": url} if url else {}) | {
        "id": rule.id,
        "name": "".join(word.capitalize() for word in rule.slug.split("-")),
        "shortDescription": {"text": rule.statement},
        "fullDescription": {"text": rule.rationale},
        "help": {"text": f"{rule.rationale}\n\nHow to repair it: {rule.hint}"},
        "defaultConfiguration": {"level": _SARIF_LEVELS[rule.severity]},
        "properties": {
            "slug": rule.slug,
            "level": rule.level.word,
            "tags": [rule.family, rule.level.word, *([rule.target] if rule.target else [])],
        },
    }


def _artifact_entry(entry: Entry) -> Json:
    artifact: Json = {"location": {"uri": _path_uri(entry.path)}, "roles": ["analysisTarget"]}
    if isinstance(entry, Report):
        artifact["length"] = entry.size
        artifact |= {"hashes": {"sha-256": entry.sha256}} if entry.sha256 else {}
    return artifact


def _path_uri(path: str) -> str:
    """Convert a file path to a URI reference; a relative path gives a relative one."""
    quoted_path = quote(os.fsencode(Path(path).as_posix()))
    return f"file://{quoted_path}" if Path(path).is_absolute() else quoted_path


def _invocation_entry(entries: Iterable[Entry]) -> Json:
    failures = [
        failure
        for number, entry in enumerate(entries)
        for failure in _entry_failures(entry, number)
    ]
    return {"executionSuccessful": not failures, "toolExecutionNotifications": failures}


def _entry_failures(entry: Entry, number: int) -> list[Json]:
    """Return SARIF notifications of an unreadable file or of crashed validation rules."""
    if isinstance(entry, Unreadable):
        return [_failure_notification(entry.path, number, str(entry.error))]
    messages = [
        (outcome.rule, f"{outcome.rule.id} crashed: {outcome.reason}")
        for outcome in _crashed_outcomes(entry)
    ]
    messages += [
        (outcome.rule, f"{outcome.rule.id} is required, but {outcome.status}: {outcome.reason}")
        for outcome in entry.unchecked
    ]
    return [_failure_notification(entry.path, number, text, rule) for rule, text in messages]


def _failure_notification(path: str, number: int, text: str, rule: Rule | None = None) -> Json:
    notification: Json = {
        "level": "error",
        "message": {"text": printable(text, kept_chars="\n")},
        "locations": [{"physicalLocation": _physical_location(path, number)}],
    }
    return notification | ({"associatedRule": {"id": rule.id}} if rule else {})


def _physical_location(path: str, number: int) -> Json:
    return {
        "artifactLocation": {"uri": _path_uri(path), "index": number},
        "region": {"startLine": 1},
    }


def _result_entry(report: Report, finding: Finding, rule: int, number: int) -> Json:
    level = _SARIF_LEVELS[finding.severity]
    if finding.certainty == "possible" and level == "error":
        level = "warning"  # a possible finding does not fail the model
    result: Json = {
        "ruleId": finding.rule,
        "ruleIndex": rule,
        "kind": "fail",
        "level": level,
        "message": {"text": printable(f"{finding.where}: {finding.message}")},
        "locations": [
            {
                "physicalLocation": _physical_location(report.path, number),
                "logicalLocations": [_logical_location(finding)],
            }
        ],
        "partialFingerprints": {_FINGERPRINT_KEY: finding.fingerprint},
        "properties": {
            "certainty": finding.certainty,
            "count": finding.count,
            "total": finding.total,
            "hint": finding.hint,
            "source": finding.source,
        },
    }
    if report.baseline:
        result["baselineState"] = "unchanged" if finding.known else "new"
    return result | {"suppressions": _sarif_suppressions(finding)}


def _logical_location(finding: Finding) -> Json:
    kind, _, name = finding.where.subject.partition(" ")
    return {
        "name": printable(finding.where.field or name or kind),
        "fullyQualifiedName": printable(str(finding.where)),
        "kind": "variable" if kind in ("input", "output") else "member",
    }


def _sarif_suppressions(finding: Finding) -> list[Json]:
    if not finding.waived:
        return []
    reason = finding.waiver or f"{finding.rule} is ignored by the settings"
    return [{"kind": "external", "status": "accepted", "justification": reason}]

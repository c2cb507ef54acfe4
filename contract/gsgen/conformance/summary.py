"""Formats the result of a conformance run as text and as JSON."""

__all__ = ["SCHEMA", "exit_code", "lines_of", "to_json"]

from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from gsgen.conformance.cases import Case, CaseStatus
from gsgen.conformance.run import ModelRun
from gsgen.contract._safe_text import for_json
from gsgen.contract.errors import ExitCode
from gsgen.contract.reporters.json_report import to_dict
from gsgen.contract.reporters.text import Line
from gsgen.contract.validation.report import Unreadable

SCHEMA = "gsgen-conformance/1"

Entry = ModelRun | Unreadable

_STATUS_ORDER: tuple[CaseStatus, ...] = (
    *("passed", "failed", "crashed", "warned", "expected", "skipped"),
)
_STYLE: dict[CaseStatus, str] = {
    "failed": "bold red",
    "crashed": "bold red",
    "warned": "yellow",
    "expected": "cyan",
}


def exit_code(entries: Sequence[Entry]) -> ExitCode:
    """Return the exit code: 3 for a crash, 4 for an unreadable model, 1 for a failure, else 0."""
    runs = [entry for entry in entries if isinstance(entry, ModelRun)]
    statuses = {case.status for run in runs for case in run.cases}
    if "crashed" in statuses:
        return ExitCode.INTERNAL
    if len(runs) < len(entries):
        return ExitCode.UNREADABLE
    return ExitCode.FAILURE if "failed" in statuses else ExitCode.SUCCESS


def lines_of(run: ModelRun) -> list[Line]:
    """Return the text of a conformance run: suites, failures with commands, overall result."""
    report = run.report
    scope = f"validated for {report.target.label} at level {report.level.word}"
    lines = [Line(f"{report.path}: {report.kind or 'kind unknown'}, {scope}", "bold")]
    for name, cases in run.suites.items():
        worst_status = max((case.status for case in cases), key=_severity_rank)
        lines.append(Line(f"  {name:<13} {_case_counts_text(cases)}", _STYLE.get(worst_status, "")))
    for case in run.cases:
        if case.status in _STYLE:
            lines += _case_lines(run, case)
    return [*lines, _verdict(run)]


def _severity_rank(status: CaseStatus) -> int:
    return ("skipped", "passed", "expected", "warned", "failed", "crashed").index(status)


def _case_counts_text(cases: Sequence[Case]) -> str:
    count_by_status = Counter(case.status for case in cases)
    return ", ".join(
        f"{count_by_status[status]} {status}" for status in _STATUS_ORDER if count_by_status[status]
    )


def _case_lines(run: ModelRun, case: Case) -> list[Line]:
    head = Line(f"  {case.suite}: {case.name} {case.status}", _STYLE[case.status])
    return [head, *(Line(text) for text in run.text(case).splitlines())]


def _verdict(run: ModelRun) -> Line:
    code = exit_code([run])
    word = {0: "passed", 1: "failed", 3: "a rule crashed, no verdict"}[code]
    return Line(f"{word}: {_case_counts_text(run.cases)}", "bold red" if code else "bold green")


def to_json(entries: Sequence[Entry]) -> str:
    """Return the results of all models as a JSON document, with findings of `gsgen validate`."""
    document = {
        "schema": SCHEMA,
        "tool": {"name": "gsgen", "version": version("gsgen")},
        "models": [_model_entry(entry) for entry in entries],
    }
    return for_json(document)


def _model_entry(entry: Entry) -> dict[str, Any]:
    if isinstance(entry, Unreadable):
        document_of_model = to_dict(entry)
        return {key: document_of_model[key] for key in ("subject", "verdict", "error")}
    document = to_dict(entry.report)
    tested_cases = {case.rule.id for case in entry.cases}
    keys = ("subject", "target", "level", "fail_on", "settings", "environment")
    return {
        **{key: document[key] for key in keys},
        "verdict": "failed" if exit_code([entry]) else "passed",
        "counts": dict(Counter(case.status for case in entry.cases)),
        "suites": [
            {"name": name, "cases": [_case_entry(entry, case) for case in cases]}
            for name, cases in entry.suites.items()
        ],
        "findings": [
            finding for finding in document["findings"] if finding["rule"] in tested_cases
        ],
    }


def _case_entry(run: ModelRun, case: Case) -> dict[str, Any]:
    entry = {"rule": case.rule.id, "slug": case.rule.slug, "status": case.status}
    if case.status in ("skipped", "expected"):
        entry["reason"] = case.text.partition("\n")[0]
    elif case.text:
        entry["text"] = case.text
    evidence = run.evidence.get(case.rule.id)
    if evidence:
        entry["reproduce"] = evidence.command
        entry |= {"dump": str(evidence.dump)} if evidence.dump else {}
    return entry

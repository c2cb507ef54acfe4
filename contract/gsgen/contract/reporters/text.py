"""Text report for terminals: findings with locations, numbers, consequences and hints."""

__all__ = ["Line", "brief_report_line", "finding_lines", "render", "render_all"]

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from gsgen.contract._safe_text import printable
from gsgen.contract.reporters.rule_pages import drop_url
from gsgen.contract.reporters.summary import plural, summary_line, verdict_line
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import MEBIBYTE, format_mebibytes
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Cause, Entry, Report

_STYLE = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.INFO: "cyan"}
_PASS_STYLE = "bold green"
_FAILURE_STYLE = "bold red"
_WIDTH = 96
_MAX_LOCATIONS = 5
_MAX_BLOCKED_RULES = 12


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a text report and its terminal style."""

    text: str
    style: str = ""


def render_all(
    entries: Sequence[Entry], *, verbose: bool = False, quiet: bool = False
) -> list[Line]:
    """Return all reports as lines of text; for several models, the last line is a summary."""
    lines: list[Line] = []
    for entry in entries:
        if isinstance(entry, Report):
            lines += [brief_report_line(entry)] if quiet else render(entry, verbose=verbose)
    return [*lines, Line(summary_line(entries), "bold")] if len(entries) > 1 else lines


def brief_report_line(report: Report) -> Line:
    """Return a model's path and whether the model conforms, in one line."""
    return Line(printable(f"{report.path}: {verdict_line(report)}"), _verdict(report).style)


def render(report: Report, *, verbose: bool = False) -> list[Line]:
    """Return one model's validation report as lines of text.

    Args:
        report: The report of one model.
        verbose: Also show known findings, the outcome of every rule, tolerances and probes.
    """
    lines = _header_lines(report)
    causes = {cause.outcome.rule.id: cause for cause in report.causes}
    visible_findings = [
        finding for finding in report.findings if finding.counts or (finding.known and verbose)
    ]
    for rule, findings in groupby(visible_findings, lambda finding: finding.rule):
        lines += finding_lines(findings, verbose=verbose)
        if rule in causes:
            lines += _cause_lines(causes.pop(rule), verbose=verbose)
    lines += _crash_lines(report)
    known = {finding.rule for finding in report.findings if finding.known}
    for cause in causes.values():
        rule, status = cause.outcome.rule, cause.outcome.status
        mark = " (known)" if rule.id in known else ""
        lines.append(Line(f"  {rule.id} {status}{mark}: {rule.slug}"))
        lines += _cause_lines(cause, verbose=verbose)
    lines += (
        _unchecked_lines(report)
        + _inapplicable_lines(report)
        + _not_run_lines(report)
        + _skipped_lines(report)
        + _waived_lines(report)
        + _resolved_lines(report)
    )
    if verbose:
        lines += _detail_lines(report)
    if verbose or report.timed:
        lines += _probe_cost_lines(report)
    if report.timed:
        runtime_text = f"{report.runtime_seconds:.2f} s in ONNX Runtime's process"
        lines.append(Line(f"  took {report.seconds:.2f} s, of which {runtime_text}"))
    lines.append(_verdict(report))
    if url := drop_url(report.docs_url):
        lines.append(Line(f"see it in a browser: {url}"))
    return [Line(printable(line.text), line.style) for line in lines]


def _header_lines(report: Report) -> list[Line]:
    facts = [report.kind or "kind unknown"]
    if report.name:
        facts.append(f"{report.name!r}, contract {report.contract}")
    if report.capacity:
        facts.append(f"{report.capacity:,} rows")
    facts.append(_size(report.size))
    if report.external_size:
        facts.append(f"{_size(report.external_size)} external data")
    scope = f"validated for {report.target.label} at level {report.level.word}"
    settings = "" if report.settings == "defaults" else f", settings from {report.settings}"
    return [Line(f"{report.path}: {', '.join(facts)}", "bold"), Line(f"  {scope}{settings}")]


def _size(size: int) -> str:
    return format_mebibytes(size) if size >= MEBIBYTE else f"{size:,} B"


def finding_lines(findings: Iterable[Finding], *, verbose: bool = False) -> list[Line]:
    """Return findings of a report as lines of text: rule, locations, numbers and hint.

    Consecutive findings of the same rule share their heading and their hint.

    Args:
        findings: The findings, in the order of the report.
        verbose: Show all locations; otherwise the first few of a rule, and their number.
    """
    lines: list[Line] = []
    for (head, hint), group in groupby(
        findings, lambda finding: (_finding_header(finding), finding.hint)
    ):
        similar_findings = list(group)
        lines.append(Line(head, _STYLE[similar_findings[0].severity]))
        listed_findings = (
            similar_findings
            if verbose or len(similar_findings) <= _MAX_LOCATIONS
            else similar_findings[: _MAX_LOCATIONS - 1]
        )
        for finding in listed_findings:
            lines += _location_lines(finding)
        if unlisted_count := len(similar_findings) - len(listed_findings):
            lines += _wrap_text(
                f"and at {unlisted_count} more locations, which `gsgen validate -v` lists"
            )
        lines += _wrap_text(f"hint: {hint}")
    return [Line(printable(line.text), line.style) for line in lines]


def _finding_header(finding: Finding) -> str:
    certainty_text = "" if finding.certainty == "confirmed" else " (possible)"
    source = "" if finding.source == "contract" else f" [{finding.source}]"
    known = " (known)" if finding.known else ""
    return f"  {finding.rule} {finding.severity.word}{certainty_text} {finding.slug}{source}{known}"


def _location_lines(finding: Finding) -> list[Line]:
    lines = _wrap_text(f"{finding.where}: {finding.message}")
    if len(finding.examples) > 1 and finding.examples[0].row is not None:
        examples = "; ".join(str(example) for example in finding.examples[1:])
        lines += _wrap_text(f"also {examples}")
    if finding.truncated:
        lines += _wrap_text("and violations at further locations, which are not listed")
    return lines


def _cause_lines(cause: Cause, *, verbose: bool) -> list[Line]:
    blocked_text = f"so {plural(len(cause.blocked_rules), 'rule')} could not be checked"
    if len(cause.blocked_rules) > _MAX_BLOCKED_RULES and not verbose:
        return _wrap_text(f"{blocked_text}, which `gsgen validate -v` lists")
    return _wrap_text(f"{blocked_text}: {', '.join(rule.id for rule in cause.blocked_rules)}")


def _wrap_text(text: str) -> list[Line]:
    lines = textwrap.wrap(
        text,
        _WIDTH,
        initial_indent="    ",
        subsequent_indent="      ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [Line(line) for line in lines]


def _crash_lines(report: Report) -> list[Line]:
    lines: list[Line] = []
    for outcome in report.outcomes:
        if outcome.status == "crashed":
            fault = f"  {outcome.rule.id} crashed: this is a fault of the rule"
            lines.append(Line(fault, _FAILURE_STYLE))
            lines += [Line(f"    {text}") for text in outcome.reason.splitlines()]
    return lines


def _unchecked_lines(report: Report) -> list[Line]:
    lines: list[Line] = []
    for outcome in report.unchecked:
        head = f"  {outcome.rule.id} required, but {outcome.status}: {outcome.rule.slug}"
        lines.append(Line(head, _FAILURE_STYLE))
        lines += _wrap_text(outcome.reason)
    return lines


def _inapplicable_lines(report: Report) -> list[Line]:
    """Return text lines that list the requested validation rules that do not apply to the model."""
    lines: list[Line] = []
    for outcome in report.outcomes:
        if outcome.rule.id in report.selected and outcome.status == "not-applicable":
            lines.append(Line(f"  {outcome.rule.id} not applicable: {outcome.rule.slug}", "yellow"))
            lines += _wrap_text(outcome.reason)
    return lines


def _not_run_lines(report: Report) -> list[Line]:
    return [
        Line(f"  level {outcome.level.word} did not run: {outcome.reason}", "yellow")
        for outcome in report.levels
        if not outcome.ran
    ]


def _skipped_lines(report: Report) -> list[Line]:
    """Return text lines that list rules that were skipped although their validation level ran."""
    lines: list[Line] = []
    for outcome in report.not_checked:
        lines.append(Line(f"  {outcome.rule.id} skipped: {outcome.rule.slug}", "yellow"))
        lines += _wrap_text(outcome.reason)
    return lines


def _waived_lines(report: Report) -> list[Line]:
    lines: list[Line] = []
    for finding in report.findings:
        if finding.waiver:
            lines.append(Line(f"  {finding.rule} waived: {finding.slug}"))
            lines += _wrap_text(f"{finding.where}: {finding.waiver}")
    return lines


def _resolved_lines(report: Report) -> list[Line]:
    lines: list[Line] = []
    for finding in report.resolved:
        lines.append(Line(f"  {finding.rule} resolved: {finding.slug}", "green"))
        lines += _wrap_text(f"{finding.where}: {finding.message}")
    return lines


def _probe_cost_lines(report: Report) -> list[Line]:
    """Return lines with the number of model runs of each validation level, and their time."""
    lines = [Line("  levels:")]
    for level in report.levels:
        if level.ran:
            duration_text = f", {level.seconds:.2f} s" if report.timed else ""
            lines.append(
                Line(f"    {level.level.word}: {plural(level.runs, 'run')}{duration_text}")
            )
    return lines


def _detail_lines(report: Report) -> list[Line]:
    lines = [Line("  rules:")]
    for outcome in report.outcomes:
        if outcome.status in ("pass", "fail"):
            duration_text = f"{outcome.milliseconds:.1f} ms, " if report.timed else ""
            detail = f"{duration_text}{outcome.items:,} checked"
        else:
            detail = outcome.reason.splitlines()[-1]
        lines.append(
            Line(f"    {outcome.rule.id} {outcome.status}: {outcome.rule.slug} ({detail})")
        )
    lines += [Line("  tolerances:")] if report.tolerances else []
    for tolerance in report.tolerances:
        lines.append(
            Line(
                f"    {tolerance.field}: {tolerance.value:g} {tolerance.unit} (from {tolerance.source})"
            )
        )
    lines += [Line("  probes:")] if report.probes else []
    lines += [Line(f"    {label}") for label in report.probes]
    lines += [Line("  named moments:")] if report.moments else []
    lines += [Line(f"    {label}") for label in report.moments]
    return lines


def _verdict(report: Report) -> Line:
    passes = report.verdict == "conforms" and not report.unchecked
    return Line(verdict_line(report), _PASS_STYLE if passes else _FAILURE_STYLE)

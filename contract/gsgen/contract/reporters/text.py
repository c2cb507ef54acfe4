"""A report for people: what is wrong, where, how much of it, what follows, and what to do."""

__all__ = ["Line", "brief", "finding_lines", "render", "render_all"]

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from gsgen.contract.reporters.summary import plural, printable, several, verdict
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Cause, Entry, Report

_STYLE = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.INFO: "cyan"}
_VERDICT_STYLE = {"conforms": "bold green"}
_BAD = "bold red"
_WIDTH = 96
_MOST_PLACES = 5
_MOST_BLOCKED = 12
_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Line:
    """One line of text, and the style a terminal may show it in."""

    text: str
    style: str = ""


def render_all(
    entries: Sequence[Entry], *, verbose: bool = False, quiet: bool = False
) -> list[Line]:
    """Return all reports line by line, and a last line that sums up several."""
    lines: list[Line] = []
    for entry in entries:
        if isinstance(entry, Report):
            lines += [brief(entry)] if quiet else render(entry, verbose=verbose)
    return [*lines, Line(several(entries), "bold")] if len(entries) > 1 else lines


def brief(report: Report) -> Line:
    """Return the verdict alone, with the model's name."""
    return Line(printable(f"{report.path}: {verdict(report)}"), _verdict(report).style)


def render(report: Report, *, verbose: bool = False) -> list[Line]:
    """Return a report line by line.

    Args:
        report: What to show.
        verbose: Show findings that are known, what became of every rule, tolerances and probes.
    """
    lines = _head(report)
    causes = {cause.outcome.rule.id: cause for cause in report.causes}
    shown = [one for one in report.findings if one.counts or (one.known and verbose)]
    for rule, findings in groupby(shown, lambda one: one.rule):
        lines += finding_lines(findings, every=verbose)
        if rule in causes:
            lines += _consequence(causes.pop(rule), verbose)
    lines += _crashes(report)
    for cause in causes.values():
        rule, status = cause.outcome.rule, cause.outcome.status
        lines.append(Line(f"  {rule.id} {status}: {rule.slug}"))
        lines += _consequence(cause, verbose)
    lines += _not_run(report) + _left_out(report) + _waived(report) + _gone(report)
    if verbose:
        lines += _details(report)
    lines.append(_verdict(report))
    return [Line(printable(line.text), line.style) for line in lines]


def _head(report: Report) -> list[Line]:
    facts = [report.kind or "kind unknown"]
    if report.name:
        facts.append(f"{report.name!r}, contract {report.contract}")
    if report.capacity:
        facts.append(f"{report.capacity:,} rows")
    facts.append(
        f"{report.size / _MIB:.1f} MiB" if report.size >= _MIB else f"{report.size:,} B"
    )
    judged = f"judged for {report.target.label} at level {report.level.word}"
    settings = "" if report.settings == "defaults" else f", settings from {report.settings}"
    return [
        Line(f"{report.path}: {', '.join(facts)}", "bold"),
        Line(f"  {judged}{settings}"),
    ]


def finding_lines(findings: Iterable[Finding], *, every: bool = False) -> list[Line]:
    """Return what is said of findings: what, where, how much of it, and how to mend it.

    Those of one kind that follow each other share their head and their cure.

    Args:
        findings: In the order of the report.
        every: Show all places; otherwise the first few of a kind, and how many there are.
    """
    lines: list[Line] = []
    for (head, hint), group in groupby(findings, lambda one: (_head_of(one), one.hint)):
        found = list(group)
        lines.append(Line(head, _STYLE[found[0].severity]))
        shown = found if every or len(found) <= _MOST_PLACES else found[: _MOST_PLACES - 1]
        for one in shown:
            lines += _place(one)
        if left := len(found) - len(shown):
            lines += _wrapped(f"and at {left} more places, which `gsgen validate -v` lists")
        lines += _wrapped(f"mend: {hint}")
    return [Line(printable(line.text), line.style) for line in lines]


def _head_of(finding: Finding) -> str:
    doubt = "" if finding.certainty == "confirmed" else " (possible)"
    source = "" if finding.source == "contract" else f" [{finding.source}]"
    known = " (known)" if finding.known else ""
    return f"  {finding.rule} {finding.severity.word}{doubt} {finding.slug}{source}{known}"


def _place(finding: Finding) -> list[Line]:
    lines = _wrapped(f"{finding.where}: {finding.message}")
    if len(finding.examples) > 1 and finding.examples[0].row is not None:
        shown = "; ".join(str(example) for example in finding.examples[1:])
        lines += _wrapped(f"also {shown}")
    if finding.truncated:
        lines += _wrapped("with what was found at further places, which are not listed")
    return lines


def _consequence(cause: Cause, every: bool) -> list[Line]:
    blocked = f"so {plural(len(cause.blocked), 'rule')} could not be judged"
    if len(cause.blocked) > _MOST_BLOCKED and not every:
        return _wrapped(f"{blocked}, which `gsgen validate -v` lists")
    return _wrapped(f"{blocked}: {', '.join(rule.id for rule in cause.blocked)}")


def _wrapped(text: str) -> list[Line]:
    made = textwrap.wrap(
        text,
        _WIDTH,
        initial_indent="    ",
        subsequent_indent="      ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [Line(line) for line in made]


def _crashes(report: Report) -> list[Line]:
    lines: list[Line] = []
    for outcome in report.outcomes:
        if outcome.status == "crashed":
            fault = f"  {outcome.rule.id} crashed: this is a fault of the rule"
            lines.append(Line(fault, _BAD))
            lines += [Line(f"    {text}") for text in outcome.reason.splitlines()]
    return lines


def _not_run(report: Report) -> list[Line]:
    return [
        Line(f"  level {outcome.level.word} did not run: {outcome.reason}", "yellow")
        for outcome in report.levels
        if not outcome.ran
    ]


def _left_out(report: Report) -> list[Line]:
    """Name the rules that were skipped although their level ran."""
    ran = {outcome.level for outcome in report.levels if outcome.ran}
    lines: list[Line] = []
    for one in report.outcomes:
        if one.status == "skipped" and one.rule.level in ran:
            lines.append(Line(f"  {one.rule.id} skipped: {one.rule.slug}", "yellow"))
            lines += _wrapped(one.reason)
    return lines


def _waived(report: Report) -> list[Line]:
    lines: list[Line] = []
    for one in report.findings:
        if one.waiver:
            lines.append(Line(f"  {one.rule} waived: {one.slug}"))
            lines += _wrapped(f"{one.where}: {one.waiver}")
    return lines


def _gone(report: Report) -> list[Line]:
    lines: list[Line] = []
    for one in report.gone:
        lines.append(Line(f"  {one.rule} gone: {one.slug}", "green"))
        lines += _wrapped(f"{one.where}: {one.message}")
    return lines


def _details(report: Report) -> list[Line]:
    lines = [Line("  rules:")]
    for outcome in report.outcomes:
        if outcome.status in ("pass", "fail"):
            spent = f"{outcome.milliseconds:.1f} ms, {outcome.items:,} looked at"
        else:
            spent = outcome.reason.splitlines()[-1]
        lines.append(
            Line(f"    {outcome.rule.id} {outcome.status}: {outcome.rule.slug} ({spent})")
        )
    lines += [Line("  tolerances:")] if report.tolerances else []
    for one in report.tolerances:
        lines.append(Line(f"    {one.field}: {one.value:g} {one.unit} (from {one.source})"))
    lines += [Line("  probes:")] if report.probes else []
    lines += [Line(f"    {label}") for label in report.probes]
    took = f"{report.seconds:.2f} s, of which {report.runtime_seconds:.2f} s in ONNX Runtime's process"
    return [*lines, Line(f"  took {took}")]


def _verdict(report: Report) -> Line:
    return Line(verdict(report), _VERDICT_STYLE.get(report.verdict, _BAD))

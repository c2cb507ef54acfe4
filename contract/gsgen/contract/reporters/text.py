"""A report for people: what is wrong, where, how much of it, and what to do."""

__all__ = ["Line", "finding_lines", "render"]

import textwrap
from dataclasses import dataclass

from gsgen.contract.finding import Finding, Severity
from gsgen.contract.report import Report

_STYLE = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.INFO: "cyan"}
_WIDTH = 96
_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Line:
    """One line of text, and the style a terminal may show it in."""

    text: str
    style: str = ""


def render(report: Report, *, verbose: bool = False) -> list[Line]:
    """Return the report line by line; ``verbose`` lists every rule that was not judged, too."""
    lines = _head(report)
    for finding in report.findings:
        if not finding.waived:
            lines += finding_lines(finding)
    for outcome in report.outcomes:
        if outcome.status == "crashed":
            lines.append(
                Line(
                    f"  {outcome.rule.id} crashed: this is a fault of the rule", "bold red"
                )
            )
            lines += [Line(f"    {text}") for text in outcome.reason.splitlines()]
    lines += _not_run(report)
    if verbose:
        lines += _details(report)
    lines.append(_verdict(report))
    return [Line(_printable(line.text), line.style) for line in lines]


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


def finding_lines(finding: Finding) -> list[Line]:
    """Return what is said of one finding: what, where, how much of it, how to mend it."""
    style = _STYLE[finding.severity]
    doubt = "" if finding.certainty == "confirmed" else " (possible)"
    source = "" if finding.source == "contract" else f" [{finding.source}]"
    head = f"  {finding.rule} {finding.severity.word}{doubt} {finding.slug}{source}"
    lines = [Line(head, style), *_wrapped(f"{finding.where}: {finding.message}")]
    if len(finding.examples) > 1 and finding.examples[0].row is not None:
        shown = "; ".join(str(example) for example in finding.examples[1:])
        lines += _wrapped(f"also {shown}")
    lines += _wrapped(f"mend: {finding.mend}")
    return [Line(_printable(line.text), line.style) for line in lines]


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


def _printable(text: str) -> str:
    """Write control characters as escapes: a tensor's name must not steer the terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _not_run(report: Report) -> list[Line]:
    return [
        Line(f"  level {outcome.level.word} did not run: {outcome.reason}", "yellow")
        for outcome in report.levels
        if not outcome.ran
    ]


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
    lines += [Line("  probes:")] if report.probes else []
    lines += [Line(f"    {label}") for label in report.probes]
    took = f"{report.seconds:.2f} s, of which {report.runtime_seconds:.2f} s in ONNX Runtime's process"
    return [*lines, Line(f"  took {took}")]


def _verdict(report: Report) -> Line:
    counted = report.statuses
    parts = [f"{counted['pass']} rules hold"]
    for severity in reversed(Severity):
        if report.count(severity):
            word = severity.word + (
                "s" if report.count(severity) > 1 and severity > Severity.INFO else ""
            )
            parts.append(f"{report.count(severity)} {word}")
    waived = sorted({finding.rule for finding in report.findings if finding.waived})
    parts += [f"ignored: {', '.join(waived)}"] if waived else []
    for status, words in (("not-applicable", "not applicable"), ("skipped", "skipped")):
        if counted[status]:
            parts.append(f"{counted[status]} {words}")
    style = {"conforms": "bold green", "invalid": "bold red"}.get(
        report.verdict, "bold red"
    )
    word = {"internal-error": "a rule crashed, no verdict"}.get(
        report.verdict, report.verdict
    )
    return Line(f"{word}: {'; '.join(parts)}", style)

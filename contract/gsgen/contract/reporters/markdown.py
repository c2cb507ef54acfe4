"""Markdown validation report for pull requests and job summaries on GitHub.

Texts from a model stand in code spans, where they cannot format, link or mention.
"""

__all__ = ["to_markdown"]

import re
from collections.abc import Sequence
from itertools import groupby

from gsgen.contract._safe_text import for_markdown, printable
from gsgen.contract.reporters.summary import plural, summary_line, verdict_line, verdict_word
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Entry, Report, Unreadable

_VERDICT_SIGNS = {"conforms": "✅", "invalid": "❌", "internal-error": "💥"}
_UNREADABLE_STATUS_EMOJI = "⛔"


def to_markdown(entries: Sequence[Entry]) -> str:
    """Return all reports as one Markdown page; several models get a table of results first."""
    parts = [_summary_table(entries)] if len(entries) != 1 else []
    parts += [_section(entry) for entry in entries]
    return "\n\n".join(parts)


def _summary_table(entries: Sequence[Entry]) -> str:
    rows = ["| model | verdict | errors | warnings |", "|---|---|---|---|"]
    for entry in entries:
        name = code(entry.path).replace("|", "\\|")
        if isinstance(entry, Unreadable):
            rows.append(f"| {name} | {_UNREADABLE_STATUS_EMOJI} unreadable | | |")
            continue
        counts = [
            sum(f.counts and f.severity.word == word for f in entry.findings)
            for word in ("error", "warning")
        ]
        verdict_text = f"{_VERDICT_SIGNS[entry.verdict]} {verdict_word(entry)}"
        rows.append(f"| {name} | {verdict_text} | {counts[0]} | {counts[1]} |")
    return "\n".join([f"**{summary_line(entries)}**", "", *rows])


def _section(entry: Entry) -> str:
    if isinstance(entry, Unreadable):
        return f"### {_UNREADABLE_STATUS_EMOJI} {code(entry.path)}\n\n{code(str(entry.error))}"
    section_introduction = f"Validated for {entry.target.label} at level {entry.level.word}."
    parts = [
        f"### {_VERDICT_SIGNS[entry.verdict]} {code(entry.path)}",
        f"**{for_markdown(verdict_line(entry))}**",
        section_introduction,
    ]
    causes = {cause.outcome.rule.id: cause for cause in entry.causes}
    items = []
    counted = (finding for finding in entry.findings if finding.counts)
    for rule, findings in groupby(counted, lambda finding: finding.rule):
        items += [_finding_markdown(finding) for finding in findings]
        if rule in causes:
            blocked_rules = causes[rule].blocked_rules
            names = ", ".join(blocked_rule.id for blocked_rule in blocked_rules)
            rules = plural(len(blocked_rules), "rule")
            items.append(f"  - so {rules} could not be checked: {names}")
    parts += ["\n".join(items)] if items else []
    return "\n\n".join(parts + _report_details(entry))


def _finding_markdown(finding: Finding) -> str:
    certainty_text = " (possible)" if finding.certainty == "possible" else ""
    head = f"**{for_markdown(finding.rule)} {for_markdown(finding.slug)}** {finding.severity.word}{certainty_text}"
    location = f"{code(str(finding.where))}: {code(finding.message)}"
    return f"- {head} at {location}\n  - hint: {printable(finding.hint)}"


def _report_details(report: Report) -> list[str]:
    parts = [
        f"🚫 **{outcome.rule.id}** is required, but {outcome.status}: {code(outcome.reason)}"
        for outcome in report.unchecked
    ]
    for outcome in report.outcomes:
        if outcome.status == "crashed":
            last = outcome.reason.splitlines()[-1]
            parts.append(f"💥 **{outcome.rule.id}** crashed, a fault of the rule: {code(last)}")
    for level in report.levels:
        if not level.ran:
            parts.append(f"Level {level.level.word} did not run: {code(level.reason)}")
    waived_findings = [
        f"- {finding.rule} {finding.slug} at {code(str(finding.where))}: {code(finding.waiver)}"
        for finding in report.findings
        if finding.waiver
    ]
    return [*parts, "Waived:\n\n" + "\n".join(waived_findings)] if waived_findings else parts


def code(text: str) -> str:
    """Return ``text`` as a Markdown code span whose fence does not occur in the text."""
    printable_text = printable(text)
    longest_run = max((len(run) for run in re.findall("`+", printable_text)), default=0)
    code_fence = "`" * (longest_run + 1)
    padding = (
        " " if printable_text[:1] in ("`", " ", "") or printable_text[-1:] in ("`", " ") else ""
    )
    return f"{code_fence}{padding}{printable_text}{padding}{code_fence}"

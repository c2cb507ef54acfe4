"""Texts that all report formats share: one model's result, and a summary of several models."""

__all__ = ["plural", "printable", "summary_line", "verdict_line", "verdict_word"]

from collections import Counter
from collections.abc import Sequence

from gsgen.contract._safe_text import printable
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Entry, Report, Unreadable

_RULE_CRASHED_TEXT = "a rule crashed, no verdict"


def plural(count: int, noun: str) -> str:
    """Return a count with its noun in the right number: ``1 rule``, ``2 rules``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def verdict_line(report: Report) -> str:
    """Return whether a model conforms, with the numbers of rules and findings, in one line."""
    counted = report.statuses
    parts = [f"{counted['pass']} rules hold"]
    for severity in reversed(Severity):
        count = report.count(severity)
        if count:
            severity_count_text = plural(count, severity.word)
            parts.append(f"{count} info" if severity is Severity.INFO else severity_count_text)
    if report.unchecked:
        parts.append(f"required but not checked: {', '.join(o.rule.id for o in report.unchecked)}")
    if report.not_checked:
        parts.append(f"not checked: {', '.join(o.rule.id for o in report.not_checked)}")
    parts += _uncounted_rule_texts(report)
    for status, words in (("not-applicable", "not applicable"), ("skipped", "skipped")):
        if counted[status]:
            parts.append(f"{counted[status]} {words}")
    return f"{verdict_word(report)}: {'; '.join(parts)}"


def verdict_word(report: Report) -> str:
    """Return the conclusion of a validation report in words, such as ``conforms``."""
    return _RULE_CRASHED_TEXT if report.verdict == "internal-error" else report.verdict


def _uncounted_rule_texts(report: Report) -> list[str]:
    ignored_rules = {
        finding.rule for finding in report.findings if finding.waived and not finding.waiver
    }
    waived_count = sum(bool(finding.waiver) for finding in report.findings)
    known = sum(finding.known for finding in report.findings)
    parts = [f"ignored: {', '.join(sorted(ignored_rules))}"] if ignored_rules else []
    parts += [f"{waived_count} waived"] if waived_count else []
    parts += [f"{known} known from {report.baseline}"] if known else []
    resolved = f"{len(report.resolved)} resolved since {report.baseline}"
    return parts + ([resolved] if report.resolved else [])


def summary_line(entries: Sequence[Entry]) -> str:
    """Return the number of models that conform, break rules or could not be read, in one line."""
    words = Counter(
        "unreadable" if isinstance(entry, Unreadable) else verdict_word(entry) for entry in entries
    )
    names = {"conforms": "conform", _RULE_CRASHED_TEXT: "without verdict"}
    parts = [
        f"{words[word]} {word if word == 'conforms' and words[word] == 1 else name}"
        for word in ("conforms", "invalid", _RULE_CRASHED_TEXT, "unreadable")
        if words[word] and (name := names.get(word, word))
    ]
    return f"{plural(len(entries), 'model')}: {', '.join(parts) or 'no model validated'}"

"""What all reporters say alike: the verdict in a line, several of them in another."""

__all__ = ["plural", "printable", "several", "verdict", "verdict_word"]

from collections import Counter
from collections.abc import Sequence

from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Entry, Report, Unreadable

_CRASHED = "a rule crashed, no verdict"


def printable(text: str, *, keep: str = "") -> str:
    """Write control characters as escapes: a tensor's name must not steer who reads it."""
    return "".join(c if c.isprintable() or c in keep else ascii(c)[1:-1] for c in text)


def plural(count: int, noun: str) -> str:
    """Return ``1 rule``, ``2 rules``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def verdict(report: Report) -> str:
    """Return the verdict, and what was counted on the way."""
    counted = report.statuses
    parts = [f"{counted['pass']} rules hold"]
    for severity in reversed(Severity):
        count = report.count(severity)
        if count:
            said = plural(count, severity.word)
            parts.append(f"{count} info" if severity is Severity.INFO else said)
    parts += _uncounted(report)
    for status, words in (("not-applicable", "not applicable"), ("skipped", "skipped")):
        if counted[status]:
            parts.append(f"{counted[status]} {words}")
    return f"{verdict_word(report)}: {'; '.join(parts)}"


def verdict_word(report: Report) -> str:
    """Return the verdict in words."""
    return _CRASHED if report.verdict == "internal-error" else report.verdict


def _uncounted(report: Report) -> list[str]:
    ignored = {one.rule for one in report.findings if one.waived and not one.waiver}
    waived = sum(bool(one.waiver) for one in report.findings)
    known = sum(one.known for one in report.findings)
    parts = [f"ignored: {', '.join(sorted(ignored))}"] if ignored else []
    parts += [f"{waived} waived"] if waived else []
    parts += [f"{known} known from {report.baseline}"] if known else []
    gone = f"{len(report.gone)} gone since {report.baseline}"
    return parts + ([gone] if report.gone else [])


def several(entries: Sequence[Entry]) -> str:
    """Return how many models have which verdict."""
    words = Counter(
        "unreadable" if isinstance(entry, Unreadable) else verdict_word(entry)
        for entry in entries
    )
    names = {"conforms": "conform", _CRASHED: "without verdict"}
    said = [
        f"{words[word]} {word if word == 'conforms' and words[word] == 1 else name}"
        for word in ("conforms", "invalid", _CRASHED, "unreadable")
        if words[word] and (name := names.get(word, word))
    ]
    return f"{plural(len(entries), 'model')}: {', '.join(said) or 'nothing judged'}"

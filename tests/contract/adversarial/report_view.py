"""Reads reports of the validator; the only module that knows the names of their fields."""

__all__ = ["FindingView", "Judgement", "judge"]

import re
from dataclasses import dataclass
from pathlib import Path

from gsgen.contract import Finding, GsgenError, Level, Settings, load_target, validate

# Which row and which probe is no cause: "first row 0 (camera 3, time=0.429): 1.2".
_LOCATION_PATTERN = re.compile(r"(first|worst) row \d+( \([^)]*\))?")


@dataclass(frozen=True, slots=True)
class FindingView:
    """A finding: its rule, how bad and how certain it is, and the text that a person reads."""

    rule: str
    severity: str
    certainty: str
    text: str


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict on a model, and its findings, worst first."""

    verdict: str
    findings: tuple[FindingView, ...]


def judge(path: Path, target: str, level: str) -> Judgement:
    """Validate a file; a file that cannot be read counts as refused, with the error's text."""
    settings = Settings(level=Level.parse(level), target=load_target(target))
    try:
        report = validate(path, settings)
    except GsgenError as error:
        unreadable = FindingView("unreadable", "error", "confirmed", str(error))
        return Judgement("unreadable", (unreadable,))
    return Judgement(report.verdict, tuple(_view(entry) for entry in report.findings))


def _view(entry: Finding) -> FindingView:
    shown = (entry.slug.replace("-", " "), str(entry.where), entry.message, entry.hint)
    return FindingView(
        entry.rule,
        entry.severity.name.lower(),
        entry.certainty,
        _LOCATION_PATTERN.sub("row", " | ".join(shown)),
    )

"""Waivers: faults that someone has looked at and accepts, each with a reason and perhaps an end."""

__all__ = ["Review", "Waiver", "waive"]

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import date
from fnmatch import fnmatchcase
from pathlib import PurePath

from gsgen.contract.validation.finding import Finding


@dataclass(frozen=True, slots=True)
class Waiver:
    """One accepted fault: a ``[[waive]]`` table of ``gsgen.toml``.

    Attributes:
        rule: The rule's id.
        reason: Why its findings are accepted.
        where: The only place it speaks of, such as ``output gaussians``; empty for all.
        model: The only model it speaks of, a path or a pattern such as ``*.onnx``; empty for all.
        until: The last day on which it holds; None for ever.
    """

    rule: str
    reason: str
    where: str = ""
    model: str = ""
    until: date | None = None

    def __str__(self) -> str:
        return f"{self.rule} at {self.where}" if self.where else self.rule

    def covers(self, finding: Finding) -> bool:
        """Say whether it speaks of ``finding``, held or not."""
        place = self.where in ("", finding.where.subject, str(finding.where))
        return place and self.rule == finding.rule

    def holds_on(self, day: date) -> bool:
        """Say whether it has not ended before ``day``."""
        return self.until is None or day <= self.until

    def matches(self, path: PurePath) -> bool:
        """Say whether it is meant for the model at ``path``."""
        names = (path.as_posix(), path.name)
        return not self.model or any(fnmatchcase(name, self.model) for name in names)


@dataclass(frozen=True, slots=True)
class Review:
    """What rules over the report itself look at.

    Attributes:
        findings: What the other rules found.
        statuses: Rule id → what became of it.
        waivers: Those that speak of this model.
        today: The day of the validation.
    """

    findings: tuple[Finding, ...]
    statuses: Mapping[str, str]
    waivers: tuple[Waiver, ...]
    today: date


def waive(
    findings: Iterable[Finding], waivers: Iterable[Waiver], today: date
) -> tuple[Finding, ...]:
    """Return the findings, those that a waiver covers marked with its reason."""
    held = [waiver for waiver in waivers if waiver.holds_on(today)]

    def judged(finding: Finding) -> Finding:
        waiver = next((one for one in held if one.covers(finding)), None)
        return replace(finding, waived=True, waiver=waiver.reason) if waiver else finding

    return tuple(map(judged, findings))

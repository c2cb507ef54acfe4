"""Waivers: findings that the user accepts, with a reason and an optional last day."""

__all__ = ["Review", "Waiver", "apply_waivers"]

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import date
from fnmatch import fnmatchcase
from pathlib import PurePath

from gsgen.contract.validation.finding import Finding


@dataclass(frozen=True, slots=True, kw_only=True)
class Waiver:
    """A finding that the user accepts: a ``[[waive]]`` table of ``gsgen.toml``.

    Attributes:
        rule: The rule's id.
        reason: Why its findings are accepted.
        where: The only location it covers, such as ``output gaussians``; empty for all.
        model: The only model it covers, a path or a pattern such as ``*.onnx``; empty for all.
        until: The last day on which it is valid; None without end.
    """

    rule: str
    reason: str
    where: str = ""
    model: str = ""
    until: date | None = None

    def __str__(self) -> str:
        return f"{self.rule} at {self.where}" if self.where else self.rule

    def is_waiver_of(self, finding: Finding) -> bool:
        """Return whether the waiver covers ``finding``, even if the waiver has expired."""
        is_location = self.where in ("", finding.where.subject, str(finding.where))
        return is_location and self.rule == finding.rule

    def is_valid_on(self, day: date) -> bool:
        """Return whether the waiver has not expired on ``day``."""
        return self.until is None or day <= self.until

    def matches(self, path: PurePath) -> bool:
        """Return whether the waiver applies to the model at ``path``."""
        names = (path.as_posix(), path.name)
        return not self.model or any(fnmatchcase(name, self.model) for name in names)


@dataclass(frozen=True, slots=True)
class Review:
    """The input of rules about the report itself: findings, waivers, and the current date.

    Attributes:
        findings: The findings of all other rules.
        statuses: Rule id → status.
        waivers: The waivers for this model.
        today: The day of the validation.
    """

    findings: tuple[Finding, ...]
    statuses: Mapping[str, str]
    waivers: tuple[Waiver, ...]
    today: date


def apply_waivers(
    findings: Iterable[Finding], waivers: Iterable[Waiver], today: date
) -> tuple[Finding, ...]:
    """Mark each finding that a valid waiver covers, with the reason of the waiver."""
    active_waivers = [waiver for waiver in waivers if waiver.is_valid_on(today)]

    def mark_waived(finding: Finding) -> Finding:
        waiver = next(
            (candidate for candidate in active_waivers if candidate.is_waiver_of(finding)), None
        )
        return replace(finding, waived=True, waiver=waiver.reason) if waiver else finding

    return tuple(map(mark_waived, findings))

"""What a rule found: severities, levels, breaches (one place) and findings (one rule, counted)."""

__all__ = ["Certainty", "Example", "Finding", "Location", "Violation"]

import hashlib
import json
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.spec.severity import Severity

Certainty = Literal["confirmed", "possible"]


@dataclass(frozen=True, slots=True)
class Location:
    """The place of a breach.

    Attributes:
        subject: ``output gaussians``, ``input time``, ``node /mlp/MatMul``, ``manifest bounds``.
        field: The field of a packed row, such as ``opacity``; empty if it is none.
    """

    subject: str
    field: str = ""

    def __str__(self) -> str:
        return f"{self.subject}, {self.field}" if self.field else self.subject


@dataclass(frozen=True, slots=True)
class Violation:
    """One place where a rule does not hold, as the rule saw it.

    Attributes:
        where: The place.
        actual: What was there, with the value; empty for breaches of rows.
        expected: What the rule wants instead.
        bad: For rows of a chunk, which of them break the rule.
        judged: How many rows of the chunk the rule looked at.
        values: What to show of each row, [n] or [n, k].
        magnitude: How bad each row is; the largest is reported as the worst.
        min_fraction: The rule fails only if more than this share of all judged rows is bad.
        certainty: Whether it is proven or a guess from the numbers.
    """

    where: Location
    expected: str
    actual: str = ""
    bad: Bool[np.ndarray, " n"] | None = None
    judged: int = 1
    values: Float[np.ndarray, "..."] | None = None
    magnitude: Float[np.ndarray, " n"] | None = None
    min_fraction: float = 0.0
    certainty: Certainty = "confirmed"

    @classmethod
    def at(
        cls, subject: str, actual: str, expected: str, *, certainty: Certainty = "confirmed"
    ) -> "Violation":
        """Report one thing that is not as it should be."""
        return cls(Location(subject), expected, actual, certainty=certainty)

    @classmethod
    def rows(
        cls,
        where: Location,
        bad: Bool[np.ndarray, " n"],
        values: Float[np.ndarray, "..."],
        expected: str,
        *,
        judged: int,
        magnitude: Float[np.ndarray, " n"] | None = None,
        min_fraction: float = 0.0,
        certainty: Certainty = "confirmed",
    ) -> "Violation":
        """Report rows of a chunk; the engine counts them and picks the ones to show."""
        return cls(
            where,
            expected,
            bad=bad,
            judged=judged,
            values=values,
            magnitude=magnitude,
            min_fraction=min_fraction,
            certainty=certainty,
        )


@dataclass(frozen=True, slots=True)
class Example:
    """One offending row or thing, as shown in a report."""

    value: str
    row: int | None = None
    probe: str = ""

    def __str__(self) -> str:
        place = "" if self.row is None else f"row {self.row}"
        if self.probe and self.row is not None:
            place += f" ({self.probe})"
        return f"{place}: {self.value}" if place else self.value


@dataclass(frozen=True, slots=True)
class Finding:
    """All breaches of one rule at one place, counted.

    Attributes:
        rule: The rule's id.
        slug: The rule's readable name.
        severity: After configuration and target.
        where: The place.
        message: What was seen and what was wanted, in one line.
        hint: What to do about it.
        count: How many rows or things break the rule; never capped.
        total: How many were looked at.
        examples: The first few.
        worst: The worst, where the rule can say.
        certainty: ``confirmed`` or ``possible``.
        source: ``contract``, or the target that raised it.
        waived: It is reported but does not count.
        waiver: The reason that a waiver gives for that; empty for rules that are ignored.
        known: It stood in the baseline already, and does not count.
        truncated: It counts what was found at further places, too.
    """

    rule: str
    slug: str
    severity: Severity
    where: Location
    message: str
    hint: str
    count: int
    total: int
    examples: tuple[Example, ...] = field(default=())
    worst: Example | None = None
    certainty: Certainty = "confirmed"
    source: str = "contract"
    waived: bool = False
    waiver: str = ""
    known: bool = False
    truncated: bool = False

    @property
    def counts(self) -> bool:
        """Whether it is held against the model."""
        return not (self.waived or self.known)

    @property
    def fingerprint(self) -> str:
        """The same for as long as the fault is: over runs, machines and numbers of rows."""
        of_rows = any(example.row is not None for example in self.examples)
        kind = ("rows" if of_rows else "thing", self.certainty)
        text = json.dumps((self.rule, self.where.subject, self.where.field, *kind))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

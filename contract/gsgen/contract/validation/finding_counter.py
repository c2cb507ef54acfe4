"""Count breaches: however many rows break a rule, one finding a rule and place comes out."""

__all__ = ["FindingCounter"]

from dataclasses import dataclass, field

import numpy as np

from gsgen.contract.validation.finding import Certainty, Example, Location, Violation

_SHOWN = 5


@dataclass(slots=True)
class FindingCounter:
    """The breaches of one rule at one place.

    Attributes:
        where: The place.
        expected: What the rule wants.
        actual: What was there, for breaches that are not of rows.
        count: Bad rows or things, never capped.
        total: Judged rows or things.
        examples: The first few.
        worst: The worst row so far.
        magnitude: How bad that one is.
        min_fraction: The rule fails above this share only.
        by_rows: Rows are counted, not things.
        truncated: It counts what was found at further places, too.
    """

    where: Location
    expected: str
    actual: str = ""
    count: int = 0
    total: int = 0
    examples: list[Example] = field(default_factory=list)
    worst: Example | None = None
    magnitude: float = -np.inf
    min_fraction: float = 0.0
    certainty: Certainty = "confirmed"
    by_rows: bool = False
    truncated: bool = False

    def add(self, breach: Violation, probe: str = "", start: int = 0) -> None:
        """Add one breach; ``start`` is the number of its chunk's first row."""
        self.total += breach.judged
        self.min_fraction = breach.min_fraction
        if breach.bad is None:
            self.count += 1
            if len(self.examples) < _SHOWN:
                self.examples.append(Example(breach.actual, None, probe))
            return
        self.by_rows = True
        count = int(np.count_nonzero(breach.bad))
        if count:
            self.count += count
            self._remember(breach, probe, start)

    def _remember(self, breach: Violation, probe: str, start: int) -> None:
        assert breach.bad is not None
        assert breach.values is not None
        if len(self.examples) < _SHOWN:
            for row in np.flatnonzero(breach.bad)[: _SHOWN - len(self.examples)]:
                self.examples.append(_example(breach.values, row, probe, start))
        if breach.magnitude is None:
            return
        magnitude = np.where(np.isnan(breach.magnitude), np.inf, breach.magnitude)
        masked = np.where(breach.bad, magnitude, -np.inf)
        worst = int(np.argmax(masked))
        if masked[worst] > self.magnitude:
            self.magnitude = float(masked[worst])
            self.worst = _example(breach.values, worst, probe, start)

    @property
    def fails(self) -> bool:
        """Whether enough was bad for the rule to fail."""
        return self.count > 0 and self.count > self.min_fraction * self.total

    def message(self) -> str:
        """Say what was seen and what was wanted, in one line."""
        if not self.by_rows:
            more = f" (and {self.count - 1} more like it)" if self.count > 1 else ""
            probe = f" ({self.examples[0].probe})" if self.examples[0].probe else ""
            return f"{self.actual}{probe}{more}; wanted {self.expected}"
        share = 100 * self.count / max(self.total, 1)
        text = (
            f"{self.count} of {self.total} rows ({share:.3g} %), first {self.examples[0]}"
        )
        if self.worst is not None and self.worst != self.examples[0]:
            text += f", worst {self.worst}"
        return f"{text}; wanted {self.expected}"


def _example(values: np.ndarray, row: int, probe: str, start: int) -> Example:
    shown = np.atleast_1d(values[row])
    text = ", ".join(f"{value:.6g}" for value in shown[:10].tolist())
    return Example(text if len(shown) == 1 else f"({text})", start + int(row), probe)

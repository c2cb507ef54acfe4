"""Counts rule violations, so that a report has one finding per rule and location."""

__all__ = ["FindingCounter"]

from dataclasses import dataclass, field

import numpy as np

from gsgen.contract.validation.finding import (
    Certainty,
    Distribution,
    Example,
    Location,
    Statistic,
    Violation,
    line_hint,
)

_MAX_EXAMPLES = 5
# Rows of a chunk that are sampled for a histogram, and its bins.
_MAX_SAMPLED_VALUES = 2048
_BIN_COUNT = 24
# Invalid rows are hidden if no more than this share is.
_MAX_HIDDEN_SHARE = 0.5


@dataclass(slots=True, kw_only=True)
class FindingCounter:
    """Counts the violations of one validation rule at one location.

    Attributes:
        where: The location.
        expected: The value that the rule expects.
        actual: The offending value, for violations that are not of rows.
        count: Invalid rows or values, never capped.
        total: Checked rows or values.
        examples: The first few.
        worst: The worst row so far.
        magnitude: The magnitude of the worst row.
        min_fraction: The rule fails only above this fraction of invalid rows.
        counts_by_rows: Rows are counted, not single values.
        truncated: The counter also holds violations at further locations.
        statistic: The number that the rule compared first.
        hint: The first hint of a violation; empty for that of the rule.
        samples: Values of checked rows, and which of them break the rule.
        can_be_zeroed: The rule takes rows of zeros for absent ones.
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
    counts_by_rows: bool = False
    truncated: bool = False
    statistic: Statistic | None = None
    hint: str = ""
    samples: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    can_be_zeroed: bool = False

    def add(self, violation: Violation, probe: str = "", start: int = 0) -> None:
        """Count a rule violation; ``start`` is the output row at which the checked chunk begins."""
        self.total += violation.checked
        self.min_fraction = violation.min_fraction
        self.statistic = self.statistic or violation.statistic
        if violation.invalid_rows is None or violation.invalid_rows.any():
            self.hint = self.hint or violation.hint
        self.can_be_zeroed = violation.can_be_zeroed
        if violation.invalid_rows is None:
            self.count += 1
            if len(self.examples) < _MAX_EXAMPLES:
                self.examples.append(Example(violation.actual, None, probe))
            return
        self.counts_by_rows = True
        count = int(np.count_nonzero(violation.invalid_rows))
        if count:
            self.count += count
            self._store_violation(violation, probe, start)
            self._sample_example(violation)

    def _store_violation(self, violation: Violation, probe: str, start: int) -> None:
        assert violation.invalid_rows is not None
        assert violation.values is not None
        if len(self.examples) < _MAX_EXAMPLES:
            for row in np.flatnonzero(violation.invalid_rows)[: _MAX_EXAMPLES - len(self.examples)]:
                self.examples.append(_example(violation.values, row, probe, start))
        if violation.magnitude is None:
            return
        magnitude = np.where(np.isnan(violation.magnitude), np.inf, violation.magnitude)
        invalid_magnitude = np.where(violation.invalid_rows, magnitude, -np.inf)
        worst = int(np.argmax(invalid_magnitude))
        if invalid_magnitude[worst] > self.magnitude:
            self.magnitude = float(invalid_magnitude[worst])
            self.worst = _example(violation.values, worst, probe, start)

    def _sample_example(self, violation: Violation) -> None:
        """Keep evenly spaced values of the checked rows, for a histogram."""
        values, invalid = violation.values, violation.invalid_rows
        if values is not None and invalid is not None and values.ndim == 1:
            step = -(-len(values) // _MAX_SAMPLED_VALUES)
            self.samples.append((values[::step].astype(np.float64), invalid[::step]))

    def distribution(self) -> Distribution | None:
        """Return the histogram of the values that a rule checked; None without finite values."""
        if not self.samples:
            return None
        values, invalid = (np.concatenate(part) for part in zip(*self.samples, strict=True))
        is_finite = np.isfinite(values)
        values, invalid = values[is_finite], invalid[is_finite]
        if not len(values):
            return None
        ends = float(values.min()), float(values.max())
        # Halves do not overflow; values of one number, or too close for bins, share one.
        width = ends[1] / 2 - ends[0] / 2
        shares = (values / 2 - ends[0] / 2) / width if width > 0 else np.full(len(values), 0.5)
        counts = [
            np.histogram(shares[mask], _BIN_COUNT, (0, 1))[0].tolist()
            for mask in (~invalid, invalid)
        ]
        return Distribution(*ends, *map(tuple, counts))

    @property
    def has_failing_finding(self) -> bool:
        """Whether so many rows or values are invalid that the validation rule fails."""
        return self.count > 0 and self.count > self.min_fraction * self.total

    def hint_of(self, rule_hint: str) -> str:
        """Return how to repair the model, and how to hide the invalid rows if they are few."""
        hint, rows = self.hint or rule_hint, {example.row for example in self.examples}
        # Rows that differ from probe to probe are sorted, or move up: their numbers say nothing.
        has_numbers = self.can_be_zeroed and len({entry.probe for entry in self.examples}) <= 1
        if not has_numbers or not self.count <= min(len(rows), _MAX_HIDDEN_SHARE * self.total):
            return hint
        line = line_hint(f"rows[{sorted(row for row in rows if row is not None)}] = 0")
        return f"{hint} To hide these rows: {line[0].lower()}{line[1:]}"

    def message(self) -> str:
        """The finding's actual and expected value in one line."""
        if not self.counts_by_rows:
            suffix = f" (and {self.count - 1} more like it)" if self.count > 1 else ""
            probe = f" ({self.examples[0].probe})" if self.examples[0].probe else ""
            return f"{self.actual}{probe}{suffix}; expected {self.expected}"
        share = 100 * self.count / max(self.total, 1)
        text = f"{self.count} of {self.total} rows ({share:.3g} %), first {self.examples[0]}"
        if self.worst is not None and self.worst != self.examples[0]:
            text += f", worst {self.worst}"
        return f"{text}; expected {self.expected}"


def _example(values: np.ndarray, row: int, probe: str, start: int) -> Example:
    row_values = np.atleast_1d(values[row])
    text = ", ".join(f"{value:.6g}" for value in row_values[:10].tolist())
    return Example(text if len(row_values) == 1 else f"({text})", start + int(row), probe)

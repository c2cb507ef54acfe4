"""Results of checking a contract rule: violations at one location, and findings that count them."""

__all__ = [
    "Certainty",
    "Distribution",
    "Example",
    "Finding",
    "Location",
    "Statistic",
    "Violation",
    "line_hint",
    "remove_hint",
    "rename_hint",
    "set_hint",
    "size_hint",
    "take_hint",
]

import hashlib
import json
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.spec.severity import Severity

Certainty = Literal["confirmed", "possible"]


def set_hint(path: str, value: object) -> str:
    """Return the hint to write a value, as JSON, at a manifest path such as ``inputs.0.range``."""
    return f"Set {path} to {json.dumps(value, ensure_ascii=False)}."


def line_hint(line: str, *, first: bool = False) -> str:
    """Return the hint to put a line of torch at the end of ``forward``, or first; empty without.

    Inputs and outputs have their names in the graph; ``rows`` is the output of the finding. A line
    that changes a part of a tensor changes a copy, not the caller's input or a weight.
    """
    target, bracket, _ = line.partition(" = ")[0].partition("[")
    line = f"{target} = {target}.clone(); {line}" if bracket else line
    return f"{'Begin' if first else 'End'} `forward` on `{line}`." if line else ""


def remove_hint(path: str, alternative: str) -> str:
    """Return the hint to remove a manifest field by its path, or to do something else."""
    return f"Remove {path}, or {alternative}."


def rename_hint(name: str, new_name: str) -> str:
    """Return the hint to give a tensor of the graph, and its entry in the manifest, another name."""
    return f"Rename {name!r} to {new_name!r}, in the graph and in the manifest."


def size_hint(symbol: str, size: int) -> str:
    """Return the hint to give a symbolic dimension a size."""
    return f"`gsgen fix MODEL --size {symbol}={size} -o COPY` gives {symbol} this size."


def take_hint(name: str, shape: str, line: str = "") -> str:
    """Return the hint to take an input of another shape, and the line of torch that fits it."""
    return f"Take {name} as {shape}. {line_hint(line, first=True)}".strip()


@dataclass(frozen=True, slots=True)
class Location:
    """The location of a rule violation: a tensor, node, manifest field, rows or file.

    Attributes:
        subject: ``output gaussians``, ``input time``, ``node /mlp/MatMul``, ``manifest bounds``.
        field: The field of a packed row, such as ``opacity``; empty for other locations.
    """

    subject: str
    field: str = ""

    def __str__(self) -> str:
        return f"{self.subject}, {self.field}" if self.field else self.subject


@dataclass(frozen=True, slots=True)
class Statistic:
    """A number that a rule compares with limits, for a plot in the report.

    Attributes:
        name: The measured quantity, with its unit.
        value: The measured number.
        low: The smallest allowed value; None without such a limit.
        high: The largest allowed value; None without such a limit.
    """

    name: str
    value: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class Distribution:
    """The histogram of the values that a rule checked, valid and invalid ones.

    Attributes:
        low: Lower edge of the first bin.
        high: Upper edge of the last bin.
        valid: The number of sampled rows in each bin that keep the rule.
        invalid: The number of those that break it.
    """

    low: float
    high: float
    valid: tuple[int, ...]
    invalid: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """One location where a contract rule does not hold, with the actual and the expected value.

    Attributes:
        where: The location.
        actual: The offending value; empty for violations of rows.
        expected: The value that the rule expects.
        invalid_rows: For rows of a chunk, which of them break the rule.
        checked: The number of rows of the chunk that the rule checked.
        values: The values of each row to report, [n] or [n, k].
        magnitude: The severity of each row; the largest is reported as the worst.
        min_fraction: The rule fails only if more than this fraction of all checked rows is
            invalid.
        certainty: ``confirmed``, or ``possible`` for a conclusion drawn from the numbers.
        statistic: The number that the rule compared, for plots.
        hint: How to repair the model, where the rule's own hint is too general.
        can_be_zeroed: The rule takes rows of zeros for absent ones, so a few may be hidden so.
    """

    where: Location
    expected: str
    actual: str = ""
    invalid_rows: Bool[np.ndarray, " n"] | None = None
    checked: int = 1
    values: Float[np.ndarray, "..."] | None = None
    magnitude: Float[np.ndarray, " n"] | None = None
    min_fraction: float = 0.0
    certainty: Certainty = "confirmed"
    statistic: Statistic | None = None
    hint: str = ""
    can_be_zeroed: bool = False

    @classmethod
    def at(
        cls,
        subject: str,
        actual: str,
        expected: str,
        *,
        certainty: Certainty = "confirmed",
        statistic: Statistic | None = None,
        hint: str = "",
    ) -> "Violation":
        """Return a rule violation at one tensor, node or manifest field."""
        return cls(
            where=Location(subject),
            expected=expected,
            actual=actual,
            certainty=certainty,
            statistic=statistic,
            hint=hint,
        )

    @classmethod
    def rows(
        cls,
        where: Location,
        invalid_rows: Bool[np.ndarray, " n"],
        values: Float[np.ndarray, "..."],
        expected: str,
        *,
        checked: int,
        magnitude: Float[np.ndarray, " n"] | None = None,
        min_fraction: float = 0.0,
        certainty: Certainty = "confirmed",
        cause: tuple[str, str] | None = None,
        can_be_zeroed: bool = False,
    ) -> "Violation":
        """Return a rule violation by packed rows: the mask of invalid rows, and their values.

        ``cause`` is the likely mistake, and the repair that was tried on the rows.
        """
        return cls(
            where=where,
            expected=expected if cause is None else f"{expected}; {': '.join(cause)}",
            hint="" if cause is None else f"{cause[1][0].upper()}{cause[1][1:]}.",
            invalid_rows=invalid_rows,
            checked=checked,
            values=values,
            magnitude=magnitude,
            min_fraction=min_fraction,
            certainty=certainty,
            can_be_zeroed=can_be_zeroed and cause is None,
        )


@dataclass(frozen=True, slots=True)
class Example:
    """One offending row or value that a report shows as an example."""

    value: str
    row: int | None = None
    probe: str = ""

    def __str__(self) -> str:
        label = "" if self.row is None else f"row {self.row}"
        if self.probe and self.row is not None:
            label += f" ({self.probe})"
        return f"{label}: {self.value}" if label else self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """All violations of one validation rule at one location, counted.

    Attributes:
        rule: The rule's id.
        slug: The rule's readable name.
        severity: The severity after settings and target.
        where: The location.
        message: The actual and the expected value, in one line.
        hint: How to repair the model.
        count: The number of rows or values that break the rule; never capped.
        total: The number of rows or values that were checked.
        examples: The first few.
        worst: The worst one, if the rule ranks them.
        certainty: ``confirmed`` or ``possible``.
        source: ``contract``, or the target that raised it.
        waived: The finding is reported but does not count.
        waiver: The reason of its waiver; empty for rules that are ignored.
        known: The baseline lists the finding already, so it does not count.
        truncated: The finding also counts violations at further locations.
        statistic: The number that the rule compared; None for most rules.
        distribution: Values of the checked rows; None for violations that are not of rows.
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
    statistic: Statistic | None = None
    distribution: Distribution | None = None

    @property
    def counts(self) -> bool:
        """Whether the finding counts against the model: neither waived nor in the baseline."""
        return not (self.waived or self.known)

    @property
    def fingerprint(self) -> str:
        """A hash that identifies the finding across runs, machines and numbers of rows."""
        has_row_examples = any(example.row is not None for example in self.examples)
        kind = ("rows" if has_row_examples else "thing", self.certainty)
        text = json.dumps((self.rule, self.where.subject, self.where.field, *kind))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

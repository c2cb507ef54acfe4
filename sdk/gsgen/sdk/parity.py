"""Compares an exported model with its torch module at many test inputs, field by field.

A row agrees as the contract defines it (:mod:`gsgen.contract.validation.agreement`). On top of it,
a few rows at a threshold may match slightly changed inputs, and rows may come in another order.
"""

__all__ = [
    "Comparison", "ModelOutput", "Parity", "Reference", "compare", "references_equal",
]  # fmt: skip

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.validation.agreement import (
    ROWS_PER_BLOCK,
    Allowance,
    Errors,
    FieldError,
    cell_errors,
    drawn_cells,
    excess_of,
    keep_worst,
    live_cells,
    row_errors,
)

# Largest share of a probe's rows that may match nearby inputs instead; one row always may.
_MAX_JUMP_FRACTION = 1e-4
# Nearby inputs are tried where this many more rows differ, so that an error names none that jumps.
_MAX_EXTRA_ROWS = 64
# Below this size, numbers of a run are compared absolutely.
_ABSOLUTE_SIZE = 1e-2
# How many times the difference between float32 and float64 in torch a model may differ, where all
# inputs are zero: kernels add in other orders.
_NOISE_FACTOR = 64.0


@dataclass(frozen=True, slots=True)
class Reference:
    """The expected, unpacked outputs of a model for one set of inputs, e.g. computed by torch."""

    probe: Probe  # the inputs
    gaussians: layout.DecodedGaussians  # the Gaussians; those of torch are neither packed nor cast
    count: int  # number of live rows
    # the cells of the Gaussians, all with the same number of them
    cells: layout.Cells | None = None

    @property
    def nbytes(self) -> int:
        """The size of all expected outputs, in bytes."""
        g, cells = self.gaussians, self.cells
        arrays = [g.position, g.opacity, g.covariance, g.sh, g.rgb]
        if cells is not None:
            arrays += [cells.position, cells.visibility, cells.covariance]
        return sum(array.nbytes for array in arrays if array is not None)

    @property
    def live_cells(self) -> int:
        """The number of cells (groups of Gaussians) with a Gaussian before the row count."""
        return (
            0
            if self.cells is None
            else live_cells(self.count, len(self.gaussians), len(self.cells))
        )


@dataclass(frozen=True, slots=True)
class ModelOutput:
    """The packed outputs of a model for one set of inputs."""

    rows: np.ndarray  # packed Gaussians, [N, 10]
    color: np.ndarray  # SH or RGB, [N, C]
    count: int  # number of live rows
    cells: np.ndarray | None = None  # packed cells, [N / K, 10]; None if the model has no cells

    def copy(self) -> "ModelOutput":
        """Return a copy of the outputs that stays valid after the run."""
        cells = None if self.cells is None else np.array(self.cells)
        return ModelOutput(np.array(self.rows), np.array(self.color), self.count, cells)

    def every_nth(self, step: int) -> "ModelOutput":
        """Return every n-th Gaussian of the outputs, or every n-th cell (group) of Gaussians."""
        if step == 1:
            return self
        cells = len(self.rows) if self.cells is None else len(self.cells)
        per_cell = len(self.rows) // max(cells, 1)

        def thin_array(array: np.ndarray) -> np.ndarray:
            grouped_array = array.reshape(cells, per_cell, -1)[::step]
            return grouped_array.reshape(-1, array.shape[1])

        live_count = np.clip(self.count - per_cell * np.arange(0, cells, step), 0, per_cell).sum()
        thinned_cells = None if self.cells is None else self.cells[::step]
        return ModelOutput(
            thin_array(self.rows), thin_array(self.color), int(live_count), thinned_cells
        )


@dataclass(frozen=True, slots=True)
class Parity:
    """The result of comparing two models: the largest error of each field over all test inputs."""

    fields: tuple[FieldError, ...]  # one entry a field
    probes: int  # number of compared probes
    # number of rows that match the expected rows of slightly changed inputs instead
    rows_at_threshold: int = 0
    reordered_probes: int = 0  # number of probes whose rows agree in another order only

    @property
    def holds(self) -> bool:
        """Whether every compared field agrees within its tolerance; NaN counts as a failure."""
        return all(field.excess <= 1 for field in self.fields)

    def describe(self) -> str:
        """Return the largest error of each output field, such as position, as one line of text."""
        parts = [
            f"{f.field} {f.error:.2g} ({100 * f.excess:.3g} % of allowed)" for f in self.fields
        ]
        if self.rows_at_threshold:
            parts.append(
                f"{self.rows_at_threshold} Gaussians at a threshold match slightly changed inputs"
            )
        if self.reordered_probes:
            parts.append(f"rows come in another order at {self.reordered_probes} probes")
        return ", ".join(parts)


NearbyReferences = Callable[[Reference], Iterable[Reference]]


class Comparison:
    """The largest error of each field, over the runs of a model that are added one at a time.

    Args:
        tolerances: Of each field.
        roundings: How often values were rounded to the storage dtype: twice, if the references
            were, too.
        nearby: Returns the expected outputs for slightly changed inputs, which a few rows may match
            instead: at a threshold, such as the border of a frustum, one kernel jumps a little
            sooner than another.
        ignores_row_order: Whether the rows of a probe may agree as a set: where the values that a module
            sorts by are equal, the order of rows is that of a kernel.
        exact: Returns the outputs that the module computes in float64, if it can. With all inputs
            zero, a network may see what it has never been trained on, and lose digits in torch
            itself: the model may differ by a multiple of that loss.
    """

    def __init__(
        self,
        tolerances: Tolerances,
        *,
        roundings: int = 1,
        nearby: NearbyReferences | None = None,
        ignores_row_order: bool = False,
        exact: Callable[[Reference], Reference | None] | None = None,
    ) -> None:
        self._allowance = Allowance(tolerances, roundings)
        self._nearby_references, self._ignores_row_order = nearby, ignores_row_order
        self._exact = exact
        self._worst_by_field: dict[str, FieldError] = {}
        self._probe_count = self._jump_row_count = self._reorder_count = 0

    def add(self, reference: Reference, output: ModelOutput) -> None:
        """Compare a model's outputs with the expected outputs for one set of test inputs."""
        self._probe_count += 1
        if reference.probe.zeros and not _is_reference_finite(reference):
            return  # the module's own fault, which rule GI009 reports
        fields, jumped_rows = _compare_probe(
            reference, output, self._allowance, self._nearby_references
        )
        ignores_order = self._ignores_row_order and reference.cells is None
        if ignores_order and not all(field.excess <= 1 for field in fields):
            sorted_output = _match_row_order(reference, output)
            unordered_fields, _ = _compare_probe(reference, sorted_output, self._allowance, None)
            if all(field.excess <= 1 for field in unordered_fields):
                fields, jumped_rows = unordered_fields, 0
                self._reorder_count += 1
        if reference.probe.zeros and not all(field.excess <= 1 for field in fields):
            fields = self._without_noise(reference, fields)
        self._jump_row_count += jumped_rows
        for field in fields:
            known = self._worst_by_field.get(field.field)
            if known is None or field.excess > known.excess:
                self._worst_by_field[field.field] = field

    def _without_noise(self, reference: Reference, fields: list[FieldError]) -> list[FieldError]:
        """Return the errors as multiples of torch's own rounding errors, where these are larger."""
        exact = self._exact(reference) if self._exact is not None else None
        if exact is None or exact.count != reference.count or reference.cells is not None:
            return fields
        rows, color = layout.encode(reference.gaussians)
        rounded = ModelOutput(rows, color, reference.count)
        noise_fields, _ = _compare_probe(exact, rounded, self._allowance, None)
        noise = {field.field: field.excess for field in noise_fields}
        return [
            replace(
                field, excess=field.excess / max(1.0, _NOISE_FACTOR * noise.get(field.field, 0))
            )
            for field in fields
        ]

    @property
    def parity(self) -> Parity:
        """The result for the runs so far."""
        fields = tuple(self._worst_by_field.values())
        return Parity(fields, self._probe_count, self._jump_row_count, self._reorder_count)


def compare(
    references: Iterable[Reference],
    outputs: Iterable[ModelOutput],
    tolerances: Tolerances,
    *,
    roundings: int = 1,
) -> Parity:
    """Compare a model's outputs with the expected outputs for each set of test inputs.

    Iterators are advanced together, so that a caller may hold one probe's arrays at a time.
    """
    comparison = Comparison(tolerances, roundings=roundings)
    for reference, output in zip(references, outputs, strict=True):
        comparison.add(reference, output)
    return comparison.parity


def _match_row_order(reference: Reference, output: ModelOutput) -> ModelOutput:
    """Return a model's output rows, reordered to match the most similar expected rows.

    Both sets are sorted by one random projection of all numbers of a row.
    """
    expected_rows, expected_color = layout.encode(reference.gaussians)
    n = reference.count
    if output.count != n or min(len(expected_rows), len(output.rows)) < n:
        return output
    width = min(expected_color.shape[1], output.color.shape[1])
    expected, actual = (
        np.concatenate([rows[:n], color[:n, :width]], axis=1).astype(np.float64)
        for rows, color in ((expected_rows, expected_color), (output.rows, output.color))
    )
    deviation = expected.std(axis=0)
    scale = np.divide(1, deviation, out=np.zeros_like(deviation), where=deviation > 0)
    direction = np.random.default_rng(0).normal(size=expected.shape[1]) * scale
    order = np.arange(len(output.rows))
    order[np.argsort(expected @ direction, kind="stable")] = np.argsort(
        actual @ direction, kind="stable"
    )
    return ModelOutput(output.rows[order], output.color[order], output.count)


def references_equal(a: Reference, b: Reference, tolerance: float = 0.0) -> bool:
    """Return whether two sets of model outputs agree bit for bit, or within a tolerance."""
    pairs = [
        (getattr(a.gaussians, name), getattr(b.gaussians, name))
        for name in ("position", "opacity", "covariance", "sh", "rgb")
    ]
    pairs += [
        (getattr(a.cells, name, None), getattr(b.cells, name, None))
        for name in ("position", "visibility", "covariance")
    ]
    return a.count == b.count and all(_arrays_agree(x, y, tolerance) for x, y in pairs)


def _arrays_agree(a: np.ndarray | None, b: np.ndarray | None, tolerance: float) -> bool:
    if a is None or b is None or a.shape != b.shape:
        return a is b
    absolute_tolerance_floor = tolerance * _ABSOLUTE_SIZE
    return np.allclose(a, b, rtol=tolerance, atol=absolute_tolerance_floor, equal_nan=True)


def _is_reference_finite(reference: Reference) -> bool:
    g, cells = reference.gaussians, reference.cells
    parts = [g.position, g.covariance, g.opacity]
    if cells is not None:
        parts += [cells.position, cells.covariance, cells.visibility]
    return all(np.isfinite(part).all() for part in parts)


def _compare_probe(
    reference: Reference, output: ModelOutput, allowance: Allowance, nearby: NearbyReferences | None
) -> tuple[list[FieldError], int]:
    """Return the worst error of each output field, and how many rows match only nearby inputs."""
    label, n = reference.probe.label, reference.count
    if output.count != n:
        error = float(abs(output.count - n))
        return [FieldError(field="count", error=error, excess=np.inf, probe=label)], 0
    if (output.cells is None) != (reference.cells is None):
        return [FieldError(field="cells", error=1.0, excess=np.inf, probe=label)], 0
    worst_by_field: dict[str, FieldError] = {}
    jumped_mask = 0
    for measure, total in ((_row_errors, n), (_cell_errors, reference.live_cells)):
        errors_at = partial(measure, output, allowance)
        pending_errors: list[tuple[Errors, np.ndarray]] = []
        # Step 1: the rows within the tolerances; the others are set aside.
        for start in range(0, total, ROWS_PER_BLOCK):
            rows = np.arange(start, min(start + ROWS_PER_BLOCK, total))
            errors = errors_at(rows, reference)
            is_within_tolerance = np.all(
                [excess_of(*pair) <= 1 for pair in errors.values()], axis=0
            )
            pending_errors.append(
                (_select_errors(errors, ~is_within_tolerance), rows[~is_within_tolerance])
            )
            keep_worst(
                worst_by_field,
                _select_errors(errors, is_within_tolerance),
                rows[is_within_tolerance],
                label,
            )
        rows = (
            np.concatenate([rows for _, rows in pending_errors])
            if pending_errors
            else np.zeros(0, np.int64)
        )
        # Step 2: a few others may be as they are nearby.
        allowed_jump_count = max(1, _MAX_JUMP_FRACTION * n) - jumped_mask
        if nearby is not None and 0 < len(rows) <= _MAX_EXTRA_ROWS + allowed_jump_count:
            errors, jumped_rows = _retry_at_nearby_inputs(
                errors_at, reference, rows, nearby(reference)
            )
            if jumped_rows <= allowed_jump_count:
                pending_errors = [(errors, rows)]
                jumped_mask += jumped_rows
        # Step 3: what remains of the others counts.
        for errors, rows in pending_errors:
            keep_worst(worst_by_field, errors, rows, label)
    return list(worst_by_field.values()), jumped_mask


def _select_errors(errors: Errors, mask: Bool[np.ndarray, " n"]) -> Errors:
    return {name: (error[mask], allowed[mask]) for name, (error, allowed) in errors.items()}


def _retry_at_nearby_inputs(
    errors_at: "_ErrorMeasure", reference: Reference, rows: np.ndarray, nearby: Iterable[Reference]
) -> tuple[Errors, int]:
    """Return each Gaussian's least error against torch outputs at the same or nearby inputs."""
    errors = errors_at(rows, reference)
    jumped_mask = np.zeros(len(rows), bool)
    for neighbour in nearby:
        if neighbour.count != reference.count or len(neighbour.gaussians) < reference.count:
            continue
        for name, pair in errors_at(rows, neighbour).items():
            matches_nearby = ~(excess_of(*errors[name]) <= 1) & (excess_of(*pair) <= 1)
            error, allowed = (
                np.where(matches_nearby, b, a) for a, b in zip(errors[name], pair, strict=True)
            )
            errors[name] = (error, allowed)
            jumped_mask |= matches_nearby
    return errors, int(np.count_nonzero(jumped_mask))


_ErrorMeasure = Callable[[np.ndarray, Reference], Errors]


def _row_errors(
    output: ModelOutput, allowance: Allowance, rows: np.ndarray, reference: Reference
) -> Errors:
    """Return the errors of some Gaussians of a model's output."""
    expected = reference.gaussians
    packed = _packed_output(expected.position, expected.opacity, expected.covariance, rows)
    color = expected.rgb if expected.sh is None else expected.sh
    assert color is not None
    colors = color[rows].reshape(len(rows), -1), output.color[rows]
    is_sh = expected.sh is not None
    return row_errors((packed, output.rows[rows]), colors, allowance, is_sh=is_sh)


def _cell_errors(
    output: ModelOutput, allowance: Allowance, rows: np.ndarray, reference: Reference
) -> Errors:
    """Return the errors of some cells (groups of Gaussians) of a model's output."""
    expected = reference.cells
    assert expected is not None
    assert output.cells is not None
    opacity, visibility = output.rows[:, layout.OPACITY], output.cells[:, layout.VISIBILITY]
    is_drawn = drawn_cells(reference.gaussians.opacity, reference.count, expected.visibility)[rows]
    is_drawn |= drawn_cells(opacity, output.count, visibility)[rows]
    packed = _packed_output(expected.position, expected.visibility, expected.covariance, rows)
    return cell_errors((packed, output.cells[rows]), is_drawn, allowance)


def _packed_output(
    position: np.ndarray, opacity: np.ndarray, covariance: np.ndarray, rows: np.ndarray
) -> Float[np.ndarray, "n 10"]:
    return np.column_stack([position[rows], opacity[rows], covariance[rows]])

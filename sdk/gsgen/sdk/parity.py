"""Compares an exported model with its torch module, each output field in its own unit.

Positions are compared in standard deviations of their Gaussian, covariances relative to their
trace, opacity absolutely, and appearance as the colour seen from 64 directions. The rounding of
the storage dtype, which no export can avoid, is added to each tolerance. Cells are compared like
Gaussians, and their visibility like opacity; the shape of a cell matters only if it is visible.
"""

__all__ = [
    "FieldParity", "ModelOutput", "Parity", "Reference", "compare", "fibonacci_directions",
    "references_equal",
]  # fmt: skip

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial, reduce

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.spec.spherical_harmonics import basis, degree_of, largest_sum

DIRECTIONS = 64

# Kernels of another library round differently in every step; a long chain of them may add up to
# this many units in the last place of float32.
_ULPS = 16
_EPSILON = {"float32": 2.0**-24, "float16": 2.0**-11}
_SUBNORMAL = {"float32": 2.0**-149, "float16": 2.0**-24}
_CHUNK = 8192
# Largest share of a probe's rows that may match nearby inputs instead; one row always may.
_JUMPING_SHARE = 1e-4
# Nearby inputs are tried where this many more rows differ, so that an error names none that jumps.
_EXTRA_ROWS_TRIED = 64
# Below this size, numbers of a run are compared absolutely.
_TYPICAL = 1e-2


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
        if self.cells is None or not len(self.cells):
            return 0
        return -(-self.count // (len(self.gaussians) // len(self.cells)))


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

    def every(self, step: int) -> "ModelOutput":
        """Return every n-th Gaussian of the outputs, or every n-th cell (group) of Gaussians."""
        if step == 1:
            return self
        cells = len(self.rows) if self.cells is None else len(self.cells)
        per_cell = len(self.rows) // max(cells, 1)

        def thinned(array: np.ndarray) -> np.ndarray:
            grouped = array.reshape(cells, per_cell, -1)[::step]
            return grouped.reshape(-1, array.shape[1])

        live = np.clip(self.count - per_cell * np.arange(0, cells, step), 0, per_cell).sum()
        kept_cells = None if self.cells is None else self.cells[::step]
        return ModelOutput(thinned(self.rows), thinned(self.color), int(live), kept_cells)


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldParity:
    """The largest error in one field of Gaussians, such as position."""

    # ``position``, ``covariance``, ``opacity`` or ``appearance``; for cells ``cell position``,
    # ``cell covariance`` or ``cell visibility``
    field: str
    error: float  # the largest error, in the field's unit
    excess: float  # the error divided by the tolerance; above 1, the comparison fails
    probe: str  # label of the probe with this error
    row: int  # index of the Gaussian, or of the cell


@dataclass(frozen=True, slots=True)
class Parity:
    """The result of comparing two models: the largest error of each field over all test inputs."""

    fields: tuple[FieldParity, ...]  # one entry a field
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


Nearby = Callable[[Reference], Iterable[Reference]]


def compare(
    references: Iterable[Reference],
    outputs: Iterable[ModelOutput],
    tolerances: Tolerances,
    *,
    roundings: int = 1,
    nearby: Nearby | None = None,
    any_order: bool = False,
) -> Parity:
    """Compare a model's outputs with the expected outputs for each set of test inputs.

    Iterators are advanced together, so that a caller may hold one probe's arrays at a time.

    ``roundings`` counts how often values were rounded to the storage dtype: twice, if the
    references were, too. ``nearby`` returns the expected outputs for slightly changed inputs. A few
    rows may match these instead: at a threshold, such as the border of a frustum, one kernel jumps
    a little sooner than another. With ``any_order``, the rows of a probe may agree as a set: where
    the values that a module sorts by are equal, the order of rows is that of a kernel.
    """
    worst: dict[str, FieldParity] = {}
    probes = jumped = reordered = 0
    for reference, output in zip(references, outputs, strict=True):
        probes += 1
        if reference.probe.zeros and not _all_finite(reference):
            continue  # the module's own fault, which rule GI009 reports
        fields, excused = _compare_probe(reference, output, tolerances, roundings, nearby)
        if any_order and reference.cells is None and not all(f.excess <= 1 for f in fields):
            sorted_output = _in_order_of(reference, output)
            as_set, _ = _compare_probe(reference, sorted_output, tolerances, roundings, None)
            if all(field.excess <= 1 for field in as_set):
                fields, excused, reordered = as_set, 0, reordered + 1
        jumped += excused
        for field in fields:
            _keep_worse(worst, field)
    return Parity(tuple(worst.values()), probes, jumped, reordered)


def _in_order_of(reference: Reference, output: ModelOutput) -> ModelOutput:
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
    spread = expected.std(axis=0)
    scale = np.divide(1, spread, out=np.zeros_like(spread), where=spread > 0)
    direction = np.random.default_rng(0).normal(size=expected.shape[1]) * scale
    order = np.arange(len(output.rows))
    order[np.argsort(expected @ direction, kind="stable")] = np.argsort(
        actual @ direction, kind="stable"
    )
    return ModelOutput(output.rows[order], output.color[order], output.count)


def _keep_worse(worst: dict[str, FieldParity], field: FieldParity) -> None:
    known = worst.get(field.field)
    if known is None or not field.excess <= known.excess:
        worst[field.field] = field


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
    return a.count == b.count and all(_alike(x, y, tolerance) for x, y in pairs)


def _alike(a: np.ndarray | None, b: np.ndarray | None, tolerance: float) -> bool:
    if a is None or b is None or a.shape != b.shape:
        return a is b
    floor = tolerance * _TYPICAL
    return np.allclose(a, b, rtol=tolerance, atol=floor, equal_nan=True)


def _all_finite(reference: Reference) -> bool:
    g, cells = reference.gaussians, reference.cells
    parts = [g.position, g.covariance, g.opacity]
    if cells is not None:
        parts += [cells.position, cells.covariance, cells.visibility]
    return all(np.isfinite(part).all() for part in parts)


def _compare_probe(
    reference: Reference,
    output: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
    nearby: Nearby | None,
) -> tuple[list[FieldParity], int]:
    """Return the worst error of each output field, and how many rows match only nearby inputs."""
    label, n = reference.probe.label, reference.count
    if output.count != n:
        return [_failure("count", abs(output.count - n), label)], 0
    if (output.cells is None) != (reference.cells is None):
        return [_failure("cells", 1.0, label)], 0
    worst: dict[str, FieldParity] = {}
    jumps = 0
    for fields, total in ((_fields, n), (_cell_fields, reference.live_cells)):
        measured = partial(_ratios, fields, output, tolerances, roundings)
        # Step 1: the rows within the tolerances; the others are set aside.
        beyond = np.zeros(total, bool)
        for start in range(0, total, _CHUNK):
            rows = np.arange(start, min(start + _CHUNK, total))
            errors = measured(rows, reference)
            fails = ~np.all([ratio <= 1 for _, ratio in errors.values()], axis=0)
            beyond[rows[fails]] = True
            _collect(worst, errors, rows, ~fails, label)
        # Step 2: a few others may be as they are nearby.
        distant = np.flatnonzero(beyond)
        allowed_jumps = max(1, _JUMPING_SHARE * n) - jumps
        if nearby is not None and 0 < len(distant) <= _EXTRA_ROWS_TRIED + allowed_jumps:
            errors, excused = _excused(measured, reference, distant, nearby(reference))
            if excused <= allowed_jumps:
                _collect(worst, errors, distant, np.ones(len(distant), bool), label)
                jumps += excused
                continue
        # Step 3: where they are many, all of them count.
        for start in range(0, len(distant), _CHUNK):
            rows = distant[start : start + _CHUNK]
            _collect(worst, measured(rows, reference), rows, np.ones(len(rows), bool), label)
    return list(worst.values()), jumps


def _failure(field: str, error: float, probe: str) -> FieldParity:
    return FieldParity(field=field, error=error, excess=np.inf, probe=probe, row=0)


def _excused(
    measured: "_Measure", reference: Reference, rows: np.ndarray, nearby: Iterable[Reference]
) -> tuple["_Errors", int]:
    """Return each Gaussian's least error against torch outputs at the same or nearby inputs."""
    errors = measured(rows, reference)
    jumps = np.zeros(len(rows), bool)
    for neighbour in nearby:
        if neighbour.count != reference.count or len(neighbour.gaussians) < reference.count:
            continue
        for name, (error, ratio) in measured(rows, neighbour).items():
            as_there = ~(errors[name][1] <= 1) & (ratio <= 1)
            error, ratio = (
                np.where(as_there, b, a) for a, b in zip(errors[name], (error, ratio), strict=True)
            )
            errors[name] = (error, ratio)
            jumps |= as_there
    return errors, int(np.count_nonzero(jumps))


def _collect(
    worst: dict[str, FieldParity],
    errors: "_Errors",
    rows: np.ndarray,
    counts: Bool[np.ndarray, " n"],
    probe: str,
) -> None:
    """Update the largest error per field, such as position, with the errors of more rows."""
    if not counts.any():
        return
    for name, (error, ratio) in errors.items():
        i = int(np.argmax(np.where(counts, ratio, -np.inf)))
        field = FieldParity(
            field=name, error=float(error[i]), excess=float(ratio[i]), probe=probe, row=int(rows[i])
        )
        _keep_worse(worst, field)


_Errors = dict[str, tuple[np.ndarray, np.ndarray]]
_Measure = Callable[[np.ndarray, Reference], _Errors]


def _ratios(
    fields: "_Fields",
    output: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
    part: np.ndarray,
    reference: Reference,
) -> _Errors:
    """Return the error of each field, and as a multiple of its tolerance; NaN becomes infinite."""
    measured = {}
    for name, error, allowed in fields(reference, part, output, tolerances, roundings):
        ratio = error / allowed
        ratio[np.isnan(ratio)] = np.inf
        measured[name] = (error, ratio)
    return measured


Measured = tuple[str, Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


_Fields = Callable[[Reference, np.ndarray, ModelOutput, Tolerances, int], Iterator[Measured]]


def _fields(
    reference: Reference,
    part: np.ndarray,
    output: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
) -> Iterator[Measured]:
    """Yield the error and the tolerance of each field of Gaussians, for every row."""
    expected = reference.gaussians
    rows = output.rows[part].astype(np.float64)
    dtype = output.rows.dtype.name
    ellipsoids = (expected.position[part], expected.covariance[part])
    yield from _ellipsoids(ellipsoids, rows, dtype, tolerances, roundings)
    rounding = roundings * _rounding(dtype)
    error = np.abs(rows[:, layout.OPACITY] - expected.opacity[part])
    yield "opacity", error, np.full(len(error), tolerances.opacity + rounding)
    color = output.color[part].astype(np.float64)
    yield _appearance(expected, part, color, rounding, tolerances)


def _cell_fields(
    reference: Reference,
    part: np.ndarray,
    output: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
) -> Iterator[Measured]:
    """Yield the error and the tolerance of each field of cells (groups of Gaussians)."""
    expected = reference.cells
    assert expected is not None
    assert output.cells is not None
    rows = output.cells[part].astype(np.float64)
    dtype = output.cells.dtype.name
    is_visible = _visible_cells(reference)[part] | ~np.isfinite(rows).all(axis=1)
    ellipsoids = (expected.position[part], expected.covariance[part])
    for name, error, allowed in _ellipsoids(ellipsoids, rows, dtype, tolerances, roundings):
        yield f"cell {name}", np.where(is_visible, error, 0.0), allowed
    error = np.abs(rows[:, layout.VISIBILITY] - expected.visibility[part])
    allowed = np.full(len(error), tolerances.opacity + roundings * _rounding(dtype))
    yield "cell visibility", error, allowed


def _visible_cells(reference: Reference) -> Bool[np.ndarray, " c"]:
    """Return the mask of visible groups of Gaussians (cells) that contain a visible Gaussian."""
    assert reference.cells is not None
    opacity = reference.gaussians.opacity
    live = np.where(np.arange(len(opacity)) < reference.count, opacity, 0.0)
    most = live.reshape(len(reference.cells), -1).max(axis=1)
    return np.asarray(most * reference.cells.visibility >= layout.CULL_OPACITY)


def _ellipsoids(
    expected: tuple[np.ndarray, np.ndarray],
    rows: Float[np.ndarray, "n 10"],
    dtype: str,
    tolerances: Tolerances,
    roundings: int,
) -> Iterator[Measured]:
    """Yield errors and tolerances of the positions and covariances of Gaussians or groups."""
    position, covariance = expected
    rounding = roundings * _rounding(dtype)
    tiny = 2 * roundings * _SUBNORMAL[dtype]
    trace = np.maximum(covariance[:, [0, 3, 5]].sum(axis=1), 1e-30)
    sigma = np.sqrt(trace / 3)

    error = _largest(rows[:, layout.POSITION] - position)
    scale = _largest(position)
    yield "position", error / sigma, tolerances.position + (rounding * scale + tiny) / sigma

    error = _largest(rows[:, layout.COVARIANCE] - covariance) / trace
    yield "covariance", error, tolerances.covariance + rounding + tiny / trace


def _appearance(
    expected: layout.DecodedGaussians,
    part: np.ndarray,
    color: np.ndarray,
    rounding: float,
    tolerances: Tolerances,
) -> Measured:
    if expected.rgb is not None:
        rgb = expected.rgb[part]
        allowed = tolerances.appearance + rounding * _largest(rgb)
        return "appearance", _largest(color[:, :3] - rgb), allowed
    assert expected.sh is not None
    sh = expected.sh[part]
    weights = basis(fibonacci_directions(DIRECTIONS), degree_of(sh.shape[1]))
    error = largest_sum(weights, color.reshape(sh.shape) - sh)
    largest = largest_sum(np.abs(weights), np.abs(sh))
    return "appearance", error, tolerances.appearance + rounding * largest


def _largest(table: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """Return the largest absolute value of each row; ``max(axis=1)`` takes four times as long."""
    return np.asarray(reduce(np.maximum, np.abs(table).T))


def _rounding(dtype: str) -> float:
    """Return the relative rounding error allowed for outputs stored as ``dtype``."""
    return _EPSILON[dtype] + _ULPS * _EPSILON["float32"]


def fibonacci_directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Return unit vectors spread evenly over the sphere (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    angle = np.pi * (1 + np.sqrt(5)) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)

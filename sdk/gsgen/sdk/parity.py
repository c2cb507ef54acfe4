"""Compare an exported model with the torch module it came from, each field in its own unit.

Positions are compared in standard deviations of their Gaussian, covariances relative to their
trace, opacity absolutely, and appearance as the colour seen from 64 directions. On top of each
tolerance comes the rounding of the storage dtype, which no export can avoid. Cells are compared
as Gaussians are, visibility as opacity; where a cell lies matters only if something of it is seen.
"""

__all__ = [
    "FieldParity",
    "ModelOutput",
    "Parity",
    "Reference",
    "compare",
    "fibonacci_directions",
    "same",
]

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.spec.spherical_harmonics import basis, degree_of, largest_sum

DIRECTIONS = 64

# Kernels of another library round differently in every step; this many units in the last place
# of float32 is what a long chain of them may add up to.
_ULPS = 16
_EPSILON = {"float32": 2.0**-24, "float16": 2.0**-11}
_SUBNORMAL = {"float32": 2.0**-149, "float16": 2.0**-24}
_CHUNK = 8192
# How many rows of a probe may be as for inputs a hair away; one always may.
_JUMPING_SHARE = 1e-4
# Below this size, numbers of a run are compared absolutely.
_TYPICAL = 1e-2


@dataclass(frozen=True, slots=True)
class Reference:
    """What a model should give for one probe, unpacked: in an export, what eager torch gave.

    Attributes:
        probe: The inputs.
        gaussians: The Gaussians, before packing and casting where torch gave them.
        count: How many rows are live.
        cells: The cells that they lie in, each with as many of them as the others.
    """

    probe: Probe
    gaussians: layout.DecodedGaussians
    count: int
    cells: layout.Cells | None = None

    @property
    def live_cells(self) -> int:
        """How many cells have a live row."""
        if self.cells is None or not len(self.cells):
            return 0
        return -(-self.count // (len(self.gaussians) // len(self.cells)))


@dataclass(frozen=True, slots=True)
class ModelOutput:
    """What a model emitted for one probe.

    Attributes:
        rows: Packed Gaussians, [N, 10].
        color: SH or RGB, [N, C].
        count: How many rows are live.
        cells: Packed cells, [N / K, 10], where the model has some.
    """

    rows: np.ndarray
    color: np.ndarray
    count: int
    cells: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class FieldParity:
    """The largest disagreement in one field.

    Attributes:
        field: ``position``, ``covariance``, ``opacity`` or ``appearance``; for cells
            ``cell position``, ``cell covariance`` or ``cell visibility``.
        error: The largest error, in the field's unit.
        excess: The error over what is allowed; above 1 is a failure.
        probe: Label of the probe where it was seen.
        row: The Gaussian, or the cell.
    """

    field: str
    error: float
    excess: float
    probe: str
    row: int


@dataclass(frozen=True, slots=True)
class Parity:
    """The result of a comparison: the worst of each field, over all probes.

    Attributes:
        fields: One entry a field.
        probes: How many probes were compared.
        jumped: Rows that were not as they should, but as for inputs a hair away.
    """

    fields: tuple[FieldParity, ...]
    probes: int
    jumped: int = 0

    @property
    def holds(self) -> bool:
        """Whether every field agrees within its tolerance; NaN does not."""
        return all(field.excess <= 1 for field in self.fields)

    def describe(self) -> str:
        """Say the largest error of each field."""
        parts = [
            f"{f.field} {f.error:.2g} ({100 * f.excess:.3g} % of allowed)"
            for f in self.fields
        ]
        if self.jumped:
            parts.append(f"{self.jumped} rows at a threshold as just beside it")
        return ", ".join(parts)


def compare(
    references: Sequence[Reference],
    outputs: Sequence[ModelOutput],
    tolerances: Tolerances,
    *,
    roundings: int = 1,
    neighbours: Mapping[int, Sequence[Reference]] | None = None,
) -> Parity:
    """Compare what a model emitted with what it should emit for the same probes.

    Args:
        references: What it should.
        outputs: What it emitted at each probe.
        tolerances: Allowed errors.
        roundings: How often values were rounded to the storage dtype: twice, where the
            references were, too.
        neighbours: Number of a probe → what it should be for inputs a hair away. A few rows may
            be as there instead: those that jump at a threshold, such as the border of a frustum,
            jump for one kernel a little sooner than for another.
    """
    worst: dict[str, FieldParity] = {}
    jumped = 0
    for index, (reference, made) in enumerate(zip(references, outputs, strict=True)):
        if reference.probe.zeros and not _all_finite(reference):
            continue  # a fault of the module itself, which rule GI009 reports
        near = (neighbours or {}).get(index, ())
        fields, excused = _compare_probe(reference, made, tolerances, roundings, near)
        if excused > max(1, _JUMPING_SHARE * reference.count):
            fields, excused = _compare_probe(reference, made, tolerances, roundings, ())
        jumped += excused
        for one in fields:
            known = worst.get(one.field)
            if known is None or not one.excess <= known.excess:
                worst[one.field] = one
    return Parity(tuple(worst.values()), len(references), jumped)


def same(a: Reference, b: Reference, tolerance: float = 0.0) -> bool:
    """Say whether two runs gave the same bits, or numbers within a relative tolerance."""
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
    made: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
    near: Sequence[Reference],
) -> tuple[list[FieldParity], int]:
    """Return the worst of each field, part by part, and how many rows were as in ``near``."""
    label, n = reference.probe.label, reference.count
    if made.count != n:
        return [FieldParity("count", abs(made.count - n), np.inf, label, 0)], 0
    if (made.cells is None) != (reference.cells is None):
        return [FieldParity("cells", 1.0, np.inf, label, 0)], 0
    near = [one for one in near if one.count == n and len(one.gaussians) >= n]
    found: list[FieldParity] = []
    excused = 0
    for fields, total in ((_fields, n), (_cell_fields, reference.live_cells)):
        for start in range(0, total, _CHUNK):
            part = slice(start, min(start + _CHUNK, total))
            measured = partial(_ratios, fields, part, made, tolerances, roundings)
            worst, jumped = _worst(reference, near, part, measured)
            found += worst
            excused += jumped
    return found, excused


def _worst(
    reference: Reference, near: Sequence[Reference], part: slice, measured: "_Measure"
) -> tuple[list[FieldParity], int]:
    """Return the worst row of each field of a part, and how many were as in ``near``."""
    found = []
    jumps = np.zeros(part.stop - part.start, bool)
    for name, (error, ratio) in measured(reference).items():
        beyond = ~(ratio <= 1)
        for one in near if beyond.any() else ():
            other = measured(one)[name]
            as_there = beyond & (other[1] <= 1)
            error, ratio = (
                np.where(as_there, b, a) for a, b in zip((error, ratio), other, strict=True)
            )
            jumps |= as_there
        row = int(np.argmax(ratio))
        worst = (float(error[row]), float(ratio[row]))
        found.append(FieldParity(name, *worst, reference.probe.label, part.start + row))
    return found, int(np.count_nonzero(jumps))


_Measure = Callable[[Reference], dict[str, tuple[np.ndarray, np.ndarray]]]


def _ratios(
    fields: "_Fields",
    part: slice,
    made: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
    reference: Reference,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return each field's error, and the error over what is allowed; NaN counts as infinite."""
    measured = {}
    for name, error, allowed in fields(reference, part, made, tolerances, roundings):
        ratio = error / allowed
        ratio[np.isnan(ratio)] = np.inf
        measured[name] = (error, ratio)
    return measured


Measured = tuple[str, Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


_Fields = Callable[[Reference, slice, ModelOutput, Tolerances, int], Iterator[Measured]]


def _fields(
    reference: Reference,
    part: slice,
    made: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
) -> Iterator[Measured]:
    """Yield each field's error and allowance, row by row."""
    wanted = reference.gaussians
    seen = made.rows[part].astype(np.float64)
    dtype = made.rows.dtype.name
    ellipsoids = (wanted.position[part], wanted.covariance[part])
    yield from _placed(ellipsoids, seen, dtype, tolerances, roundings)
    rounding = roundings * _rounding(dtype)
    error = np.abs(seen[:, layout.OPACITY] - wanted.opacity[part])
    yield "opacity", error, np.full(len(error), tolerances.opacity + rounding)
    color = made.color[part].astype(np.float64)
    yield _appearance(wanted, part, color, rounding, tolerances)


def _cell_fields(
    reference: Reference,
    part: slice,
    made: ModelOutput,
    tolerances: Tolerances,
    roundings: int,
) -> Iterator[Measured]:
    """Yield the same of cells."""
    wanted = reference.cells
    assert wanted is not None
    assert made.cells is not None
    seen = made.cells[part].astype(np.float64)
    dtype = made.cells.dtype.name
    shown = _shown(reference)[part] | ~np.isfinite(seen).all(axis=1)
    ellipsoids = (wanted.position[part], wanted.covariance[part])
    for name, error, allowed in _placed(ellipsoids, seen, dtype, tolerances, roundings):
        yield f"cell {name}", np.where(shown, error, 0.0), allowed
    error = np.abs(seen[:, layout.VISIBILITY] - wanted.visibility[part])
    allowed = np.full(len(error), tolerances.opacity + roundings * _rounding(dtype))
    yield "cell visibility", error, allowed


def _shown(reference: Reference) -> Bool[np.ndarray, " c"]:
    """Return which cells are seen, and have a Gaussian that is."""
    assert reference.cells is not None
    opacity = reference.gaussians.opacity
    live = np.where(np.arange(len(opacity)) < reference.count, opacity, 0.0)
    most = live.reshape(len(reference.cells), -1).max(axis=1)
    return np.asarray(most * reference.cells.visibility >= layout.CULL_OPACITY)


def _placed(
    wanted: tuple[np.ndarray, np.ndarray],
    seen: Float[np.ndarray, "n 10"],
    dtype: str,
    tolerances: Tolerances,
    roundings: int,
) -> Iterator[Measured]:
    """Yield the errors of where ellipsoids lie and of what shape they have."""
    position, covariance = wanted
    rounding = roundings * _rounding(dtype)
    tiny = 2 * roundings * _SUBNORMAL[dtype]
    trace = np.maximum(covariance[:, [0, 3, 5]].sum(axis=1), 1e-30)
    sigma = np.sqrt(trace / 3)

    error = np.abs(seen[:, layout.POSITION] - position).max(axis=1)
    scale = np.abs(position).max(axis=1)
    yield "position", error / sigma, tolerances.position + (rounding * scale + tiny) / sigma

    error = np.abs(seen[:, layout.COVARIANCE] - covariance).max(axis=1) / trace
    yield "covariance", error, tolerances.covariance + rounding + tiny / trace


def _appearance(
    wanted: layout.DecodedGaussians,
    part: slice,
    seen: np.ndarray,
    rounding: float,
    tolerances: Tolerances,
) -> Measured:
    if wanted.rgb is not None:
        rgb = wanted.rgb[part]
        allowed = tolerances.appearance + rounding * np.abs(rgb).max(axis=1)
        return "appearance", np.abs(seen[:, :3] - rgb).max(axis=1), allowed
    assert wanted.sh is not None
    sh = wanted.sh[part]
    weights = basis(fibonacci_directions(DIRECTIONS), degree_of(sh.shape[1]))
    error = largest_sum(weights, seen.reshape(sh.shape) - sh)
    largest = largest_sum(np.abs(weights), np.abs(sh))
    return "appearance", error, tolerances.appearance + rounding * largest


def _rounding(dtype: str) -> float:
    """Return the relative error that storage and float32 kernels may add."""
    return _EPSILON[dtype] + _ULPS * _EPSILON["float32"]


def fibonacci_directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Return unit vectors spread evenly over the sphere (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    angle = np.pi * (1 + np.sqrt(5)) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)

"""Compare an exported model with the torch module it came from, each field in its own unit.

Positions are compared in standard deviations of their Gaussian, covariances relative to their
trace, opacity absolutely, and appearance as the colour seen from 64 directions. On top of each
tolerance comes the rounding of the storage dtype, which no export can avoid.
"""

__all__ = [
    "FieldParity",
    "Parity",
    "Reference",
    "compare",
    "fibonacci_directions",
    "same",
]

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gsgen.contract import layout
from gsgen.contract.manifest import Tolerances
from gsgen.contract.probes import Probe
from gsgen.contract.spherical_harmonics import basis, degree_of

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
    """

    probe: Probe
    gaussians: layout.Gaussians
    count: int


@dataclass(frozen=True, slots=True)
class FieldParity:
    """The largest disagreement in one field.

    Attributes:
        field: ``position``, ``covariance``, ``opacity`` or ``appearance``.
        error: The largest error, in the field's unit.
        excess: The error over what is allowed; above 1 is a failure.
        probe: Label of the probe where it was seen.
        row: The Gaussian.
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
    references: list[Reference],
    outputs: list[tuple[np.ndarray, np.ndarray, int]],
    tolerances: Tolerances,
    *,
    roundings: int = 1,
    neighbours: Mapping[int, Sequence[Reference]] | None = None,
) -> Parity:
    """Compare what a model emitted with what it should emit for the same probes.

    Args:
        references: What it should.
        outputs: ``(gaussians [C, 10], appearance [C, channels], count)`` of each probe.
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
    pairs = (
        (getattr(a.gaussians, name), getattr(b.gaussians, name))
        for name in ("position", "opacity", "covariance", "sh", "rgb")
    )
    return a.count == b.count and all(_alike(x, y, tolerance) for x, y in pairs)


def _alike(a: np.ndarray | None, b: np.ndarray | None, tolerance: float) -> bool:
    if a is None or b is None or a.shape != b.shape:
        return a is b
    floor = tolerance * _TYPICAL
    return np.allclose(a, b, rtol=tolerance, atol=floor, equal_nan=True)


def _all_finite(reference: Reference) -> bool:
    g = reference.gaussians
    return all(np.isfinite(part).all() for part in (g.position, g.covariance, g.opacity))


def _compare_probe(
    reference: Reference,
    made: tuple[np.ndarray, np.ndarray, int],
    tolerances: Tolerances,
    roundings: int,
    near: Sequence[Reference],
) -> tuple[list[FieldParity], int]:
    """Return the worst of each field, part by part, and how many rows were as in ``near``."""
    rows, color, count = made
    label, n = reference.probe.label, reference.count
    if count != n:
        return [FieldParity("count", abs(count - n), np.inf, label, 0)], 0
    near = [one for one in near if one.count == n and len(one.gaussians) >= n]
    found: list[FieldParity] = []
    excused = 0
    for start in range(0, n, _CHUNK):
        part = slice(start, min(start + _CHUNK, n))
        measured = _ratios(reference, part, rows, color, tolerances, roundings)
        jumps = np.zeros(part.stop - start, bool)
        for name, (error, ratio) in measured.items():
            beyond = ~(ratio <= 1)
            for one in near if beyond.any() else ():
                other = _ratios(one, part, rows, color, tolerances, roundings)[name]
                as_there = beyond & (other[1] <= 1)
                error, ratio = (
                    np.where(as_there, b, a)
                    for a, b in zip((error, ratio), other, strict=True)
                )
                jumps |= as_there
            row = int(np.argmax(ratio))
            worst = (float(error[row]), float(ratio[row]))
            found.append(FieldParity(name, *worst, label, start + row))
        excused += int(np.count_nonzero(jumps))
    return found, excused


def _ratios(
    reference: Reference,
    part: slice,
    rows: np.ndarray,
    color: np.ndarray,
    tolerances: Tolerances,
    roundings: int,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return each field's error, and the error over what is allowed; NaN counts as infinite."""
    made = {}
    for name, error, allowed in _fields(
        reference.gaussians, part, rows, color, tolerances, roundings
    ):
        ratio = error / allowed
        ratio[np.isnan(ratio)] = np.inf
        made[name] = (error, ratio)
    return made


Measured = tuple[str, Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


def _fields(
    wanted: layout.Gaussians,
    part: slice,
    rows: np.ndarray,
    color: np.ndarray,
    tolerances: Tolerances,
    roundings: int,
) -> Iterator[Measured]:
    """Yield each field's error and allowance, row by row."""
    seen = rows[part].astype(np.float64)
    rounding = roundings * _rounding(rows.dtype.name)
    tiny = 2 * roundings * _SUBNORMAL[rows.dtype.name]
    position, covariance = wanted.position[part], wanted.covariance[part]
    trace = np.maximum(covariance[:, [0, 3, 5]].sum(axis=1), 1e-30)
    sigma = np.sqrt(trace / 3)

    error = np.abs(seen[:, layout.POSITION] - position).max(axis=1)
    scale = np.abs(position).max(axis=1)
    yield "position", error / sigma, tolerances.position + (rounding * scale + tiny) / sigma

    error = np.abs(seen[:, layout.COVARIANCE] - covariance).max(axis=1) / trace
    yield "covariance", error, tolerances.covariance + rounding + tiny / trace

    error = np.abs(seen[:, layout.OPACITY] - wanted.opacity[part])
    yield "opacity", error, np.full(len(error), tolerances.opacity + rounding)
    yield _appearance(wanted, part, color[part].astype(np.float64), rounding, tolerances)


def _appearance(
    wanted: layout.Gaussians,
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
    difference = seen.reshape(sh.shape) - sh
    error = np.abs(np.einsum("dk,nkc->ndc", weights, difference)).max(axis=(1, 2))
    largest = np.einsum("dk,nkc->ndc", np.abs(weights), np.abs(sh)).max(axis=(1, 2))
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

"""Encodes the frames of a sequence as a clip: groups of rows, each with tables of its own."""

__all__ = ["USUAL_ERROR", "ErrorBudget", "encode_groups"]

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from gsgen.contract.spec import layout
from gsgen.sdk.sequences.clip import DIGIT_ZERO, SIZE_STEP, RowGroup, Table, sizes_of
from gsgen.sdk.sequences.frame_store import COLOR, FrameStore
from gsgen.sdk.sequences.low_rank import Basis, find_basis
from gsgen.sdk.sequences.quantisation import constant_table, digit_table

# Sizes below this share of the median count as that size: their errors do not show.
_MIN_SIZE_SHARE: Final = 0.25
# Groups below this share of the rows, and below so many rows, join the next more general group.
_MIN_GROUP_SHARE, _MIN_GROUP_ROWS = 0.01, 64
_KEY_STRIDES: Final = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20)


USUAL_ERROR: Final = 0.08
"""The error of centres of the default budget, in units of each Gaussian's size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorBudget:
    """Errors that an encoded sequence may have, each as a root mean square over a frame's rows.

    Attributes:
        motion: Of centres, in units of each Gaussian's size (its root mean square radius).
        factors: Of Cholesky factors, in the same units.
        opacity: Of opacities.
        color: Of the base colour: RGB, or the constant SH term.
    """

    motion: float = USUAL_ERROR
    factors: float = 0.03
    opacity: float = 0.015
    color: float = 0.01

    def scaled(self, factor: float) -> "ErrorBudget":
        """Return the budget with all errors times a factor."""
        return ErrorBudget(
            **{entry.name: getattr(self, entry.name) * factor for entry in fields(self)}
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _RowFacts:
    """What all frames together say about each row of a sequence."""

    mean: Float64[np.ndarray, "n 3"]  # centre
    size: Float64[np.ndarray, " n"]  # root mean square radius
    moves: Bool[np.ndarray, " n"]  # whether centre or factors change
    changes: Bool[np.ndarray, " n"]  # whether opacity or colour change


def encode_groups(store: FrameStore, budget: ErrorBudget, *, loop: bool) -> tuple[RowGroup, ...]:
    """Return the rows of a sequence in at most four groups, each encoded within the budget.

    Groups differ by whether their Gaussians move, and by whether their opacity or colour changes.
    """
    facts = _row_facts(store, budget)
    unit = max(float(np.median(facts.size)), 1e-12)
    facts = replace(facts, size=np.maximum(facts.size, _MIN_SIZE_SHARE * unit))
    # A step of a tenth of the smallest sizes places a centre far more exactly than it is seen.
    place_step = 0.1 * _MIN_SIZE_SHARE * unit
    return tuple(
        _GroupEncoder(store, rows, facts, budget, unit=unit, loop=loop).encode(place_step)
        for rows in _groups_of(facts)
    )


def _row_facts(store: FrameStore, budget: ErrorBudget) -> _RowFacts:
    count = store.rows
    mean, size = np.empty((count, 3)), np.empty(count)
    moves, changes = np.empty(count, bool), np.empty(count, bool)
    for part, block in store.blocks():
        average = block.mean(axis=0, dtype=np.float64)
        mean[part] = average[:, layout.POSITION]
        squares = np.square(block[..., layout.COVARIANCE]).sum(axis=2).mean(axis=0)
        size[part] = np.sqrt(squares / 3)
        # Half of the distance between the extremes is the largest error of a constant.
        spread = (block.max(axis=0) - block.min(axis=0)).astype(np.float64) / 2
        radius = np.maximum(size[part], 1e-12)[:, None]
        moves[part] = (spread[:, layout.POSITION] > budget.motion * radius).any(axis=1)
        moves[part] |= (spread[:, layout.COVARIANCE] > budget.factors * radius).any(axis=1)
        changes[part] = spread[:, layout.OPACITY] > budget.opacity
        changes[part] |= (spread[:, COLOR] > budget.color).any(axis=1)
    return _RowFacts(mean=mean, size=size, moves=moves, changes=changes)


def _groups_of(facts: _RowFacts) -> Iterator[Int64[np.ndarray, " m"]]:
    """Yield the row numbers of each group; small groups join a more general one."""
    moves, changes = facts.moves.copy(), facts.changes.copy()
    least = max(_MIN_GROUP_ROWS, int(_MIN_GROUP_SHARE * len(moves)))
    for flag, other in ((changes, moves), (moves, changes)):
        for value in (False, True):
            # Rows for which the flag is not set take the tables of those for which it is.
            unset, is_set = (~flag & (other == value)), (flag & (other == value))
            if is_set.any() and unset.sum() < least:
                flag[unset] = True
    for moving in (False, True):
        for changing in (False, True):
            rows = np.flatnonzero((moves == moving) & (changes == changing))
            if len(rows):
                yield rows


class _GroupEncoder:
    """Encodes the rows of one group, in two passes over their frames.

    The first pass sums Gram matrices, from which the components follow; the second projects the
    frames on them.
    """

    def __init__(
        self,
        store: FrameStore,
        rows: Int64[np.ndarray, " m"],
        facts: _RowFacts,
        budget: ErrorBudget,
        *,
        unit: float,
        loop: bool,
    ) -> None:
        self._store, self._rows, self._budget, self._loop = store, rows, budget, loop
        self._unit, self._mean = unit, facts.mean[rows]
        exponent = np.rint(np.log(facts.size[rows] / unit) / SIZE_STEP)
        self._size_bytes: UInt8[np.ndarray, " m"] = (
            (exponent + DIGIT_ZERO).clip(0, 255).astype(np.uint8)
        )
        self._size = sizes_of(self._size_bytes, unit)
        self._moves = bool(facts.moves[rows].any())
        self._changes = bool(facts.changes[rows].any())

    def encode(self, place_step: float) -> RowGroup:
        """Return the group; ``place_step`` is the step of mean centres."""
        place = constant_table(self._mean.T, place_step)
        bases = self._bases()
        parts: dict[str, list[Float32[np.ndarray, ...]]] = {name: [] for name in bases}
        means: dict[str, list[Float32[np.ndarray, ...]]] = {name: [] for name in bases}
        # Pass 2: project the frames on the components.
        for _, values in self._values(place.at(np.ones(1))):
            for name, basis in bases.items():
                flat = values[name]
                frames = flat.reshape(len(flat), -1)
                average = frames.mean(axis=0, dtype=np.float64).astype(np.float32)
                components = basis.weights.T.astype(np.float32) @ (frames - average)
                parts[name].append(components.reshape(basis.weights.shape[1], *flat.shape[1:]))
                means[name].append(average.reshape(flat.shape[1:]))
        tables = {
            name: self._table(
                np.concatenate(means[name], axis=1),
                np.concatenate(parts[name], axis=2),
                bases[name],
                step,
            )
            for name, step in self._steps().items()
            if name in bases
        }
        return RowGroup(
            rows=self._rows,
            size=self._size_bytes,
            size_unit=self._unit,
            place=place,
            motion=tables.get("motion"),
            factors=tables["factors"],
            opacity=tables["opacity"],
            color=tables["color"],
        )

    def _steps(self) -> dict[str, float]:
        budget = self._budget
        return {
            "motion": 2 * budget.motion,
            "factors": 2 * budget.factors,
            "opacity": max(1 / 254, budget.opacity / 4),
            "color": budget.color,
        }

    def _values(
        self, centre: Float64[np.ndarray, "3 m"]
    ) -> Iterator[tuple[slice, dict[str, Float32[np.ndarray, "f p m"]]]]:
        """Yield the values that tables hold, for some rows at a time, as planes."""
        for part, block in self._store.blocks(self._rows):
            planes = np.moveaxis(block, 2, 1)
            size = self._size[part].astype(np.float32)
            offset = planes[:, layout.POSITION] - centre[:, part].astype(np.float32)
            yield (
                part,
                {
                    "motion": offset / size,
                    "factors": planes[:, layout.COVARIANCE] / size,
                    "opacity": planes[:, layout.OPACITY : layout.OPACITY + 1] - np.float32(0.5),
                    "color": np.ascontiguousarray(planes[:, COLOR]),
                },
            )

    def _bases(self) -> dict[str, Basis]:
        """Return the components of each table; without any, its values are constant."""
        frames, budget = self._store.frames, self._budget
        empty = Basis(np.zeros((frames, 0)), np.zeros(1))
        names = ["motion", "factors"] if self._moves else []
        names += ["opacity", "color"] if self._changes else []
        bases = dict.fromkeys(("factors", "opacity", "color"), empty)
        if not names:
            return bases
        # Pass 1: sum the Gram matrices of the values less their means.
        grams = {name: np.zeros((frames, frames)) for name in names}
        for _, values in self._values(self._mean.T):
            for name in names:
                flat = values[name].reshape(frames, -1)
                flat = flat - flat.mean(axis=0, dtype=np.float64).astype(np.float32)
                grams[name] += flat @ flat.T
        planes = {"motion": 3, "factors": 6, "opacity": 1, "color": 3}
        for name in names:
            basis = find_basis(grams[name], planes[name] * len(self._rows))
            rank = basis.rank(getattr(budget, name))
            if name == "motion" and not rank:
                continue
            bases[name] = Basis(basis.weights[:, :rank], basis.residual[: rank + 1])
        return bases

    def _table(
        self,
        mean: Float32[np.ndarray, "p m"],
        components: Float32[np.ndarray, "r p m"],
        basis: Basis,
        step: float,
    ) -> Table:
        """Return the table of a mean and of components, with steps that add up to one step."""
        rank = len(components)
        if not rank:
            return constant_table(mean, step)
        weights = np.concatenate([np.ones((len(basis.weights), 1)), basis.weights], axis=1)
        if self._loop:
            weights = np.concatenate([weights, weights[:1]])
        # The largest weight scales a component's rounding; rounding errors add up as squares.
        peaks = np.abs(basis.weights).max(axis=0)
        steps = [step, *(step / (peaks * np.sqrt(rank)))]
        return digit_table([mean, *components], weights, steps)

"""GV rules of orientation: do Gaussians align with the surface or strand of their neighbours?"""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.probing.drawn_sample import FEWEST_DRAWN, LINEAR, PLANAR, DrawnSample
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Violation
from gsgen.contract.validation.gates import VALID_ROWS
from gsgen.contract.validation.rule import rule

# A disc has a shortest axis below this fraction of its middle one, a needle a middle axis below
# this fraction of its longest; the rule applies if most rows are discs or needles.
_FLAT = 0.5
_MOST = 0.6
# The statistic is 0 where every disc lies in the plane of its neighbours, and every needle on
# their line, and 1 for directions drawn at random. Right scenes have 0.01 to 0.40, wrong
# quaternions and axes 0.61 to 1.3.
_UNRELATED = 0.55
_FITTING = 0.3
_RANDOM = 1 / 3

# Axis-aligned Gaussians of which the longest axis is this much longer than the shortest.
_LONG = 10.0
_ALIGNED = 0.99


@rule(
    "GV041",
    "orientation-follows-neighbours",
    Severity.WARNING,
    over="sample",
    fixture="quaternions_in_another_order",
    needs=(*VALID_ROWS, "GV042"),
    explained_by=("GB035",),
)
def orientation_follows_neighbours(sample: DrawnSample) -> Iterator[Violation]:
    """Flat Gaussians lie in the surface of their neighbours, and thin ones along their strand.

    Why:
        The thinnest axis of a disc is the normal of its surface, and the longest axis of a needle
        the direction of its strand. Where neither fits the neighbours, covariances were rotated
        in another way than positions: the surface looks like a hedgehog.

    Hint:
        Check the order of the quaternion (w x y z, not x y z w), normalise it, and build R S Sᵀ Rᵀ,
        not Rᵀ S Sᵀ R. Turn, mirror, swap or sort covariances and positions together.
    """
    measured = _deviation(sample)
    if measured is None or measured[0] <= _UNRELATED:
        return
    deviation, axis, shape = measured
    actual = f"deviation {deviation:.2f} of the orientation from the neighbours' {shape}"
    turned = _explaining_axes(sample, axis)
    if turned:
        actual += f"; it would fit if the axes of the covariances were {turned}"
    expected = f"below {_UNRELATED}: 0 is along the surface or strand, 1 is random"
    location = Location(sample.emission.rows_place, "covariance")
    yield Violation(where=location, expected=expected, actual=actual, certainty="possible")


def _deviation(sample: DrawnSample) -> tuple[float, int, str] | None:
    """Return how far Gaussians' axes deviate from their neighbours' surface or strand, or None."""
    scatter = sample.scatter_eigenvalues
    discs, needles = _shapes(sample)
    if _is_enough(discs) and (limit := scatter[discs, 0].mean()) < PLANAR:
        share = sample.share_along(0)[discs].mean()
        return float((share - limit) / (_RANDOM - limit)), 0, "plane"
    if _is_enough(needles) and (limit := scatter[needles, 2].mean()) > LINEAR:
        share = sample.share_along(2)[needles].mean()
        return float((limit - share) / (limit - _RANDOM)), 2, "line"
    return None


def _shapes(sample: DrawnSample) -> tuple[Bool[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    shortest, middle, longest = sample.sigma.T
    return shortest < _FLAT * middle, middle < _FLAT * longest


def _is_enough(mask: Bool[np.ndarray, " m"]) -> bool:
    return bool(mask.mean() >= _MOST and np.count_nonzero(mask) >= FEWEST_DRAWN // 2)


def _explaining_axes(sample: DrawnSample, axis: int) -> str:
    """Return the axis permutation that aligns Gaussians with their neighbours; empty if none."""
    is_shape = _shapes(sample)[0 if axis == 0 else 1]
    along, scatter = sample.axes[is_shape][:, :, axis], sample.scatter[is_shape]
    limit = sample.scatter_eigenvalues[is_shape, axis].mean()
    best, name = _FITTING, ""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=2):
            turned = along[:, order] * (*signs, 1.0)
            share = np.einsum("mi,mij,mj->m", turned, scatter, turned).mean()
            deviation = float((share - limit) / (_RANDOM - limit))
            if deviation < best:
                words = zip((*signs, 1.0), order, strict=True)
                best, name = deviation, " ".join(f"{'-' * (s < 0)}{'xyz'[i]}" for s, i in words)
    return name


@rule(
    "GV042",
    "covariance-is-rotated",
    Severity.WARNING,
    over="sample",
    fixture="rotation_left_out",
    needs=VALID_ROWS,
)
def covariance_is_rotated(sample: DrawnSample) -> Iterator[Violation]:
    """Long Gaussians are not all aligned with x, y and z, unless lines of neighbours are, too.

    Why:
        Off-diagonal entries that are exactly 0 in all rows mean that the rotation was left out: the
        diagonal alone was written, and every Gaussian points along an axis.

    Hint:
        Build R S Sᵀ Rᵀ of scales and quaternion, and write all six entries. If the scene is made of
        upright boxes, ignore this rule.
    """
    upper = sample.even[:, 4:]
    aligned = float((upper[:, [1, 2, 4]] == 0).all(axis=1).mean())
    if aligned < _ALIGNED:
        return
    measured = _deviation(sample)
    variances = upper[:, [0, 3, 5]]
    long = np.sqrt(variances.max(axis=1) / np.maximum(variances.min(axis=1), np.finfo(float).tiny))
    if measured is not None and measured[0] <= _UNRELATED:
        return
    if measured is None and np.median(long) < _LONG:
        return
    actual = (
        f"all off-diagonal entries are 0 in {aligned:.0%} of {len(upper)} rows, "
        f"whose longest axis is {_median(long):.3g} times the shortest"
    )
    expected = "rotated covariances, or axes along the surface of the neighbours"
    location = Location(sample.emission.rows_place, "covariance")
    yield Violation(where=location, expected=expected, actual=actual, certainty="possible")


def _median(values: Float[np.ndarray, " n"]) -> float:
    return float(np.median(values))

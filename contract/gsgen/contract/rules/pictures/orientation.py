"""Validation rules of orientation: do Gaussians align with the surface of their neighbours?"""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.rules.pictures.alignment import (
    MAX_FITTING_DEVIATION,
    RANDOM_DEVIATION,
    Alignment,
    is_of_shape,
    measure_alignment,
)
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Statistic, Violation
from gsgen.contract.validation.gates import VALID_ROWS
from gsgen.contract.validation.rule import rule

# Deviations above this are not those of right scenes, which have 0.40 at most.
_UNRELATED_ROUGHNESS = 0.45

# Axis-aligned Gaussians of which the longest axis is this much longer than the shortest.
_MIN_ASPECT_RATIO = 10.0
_MAX_ALIGNED_SHARE = 0.99


@rule(
    "GV041",
    Severity.WARNING,
    needs=(*VALID_ROWS, "GV020", "GV042"),
    explained_by=("GB042", "GB035"),
)
def orientation_follows_neighbours(sample: DrawnSample) -> Iterator[Violation]:
    """Flat Gaussians lie in the surface of their neighbours, and thin ones along their strand.

    Why:
        The thinnest axis of a disc is its surface's normal, the longest of a needle its strand's
        direction. Where neither fits the neighbours, covariances were rotated otherwise than
        positions: a hedgehog.

    Hint:
        Check the order of the quaternion (w x y z, not x y z w), normalise it, and build R S Sᵀ Rᵀ,
        not Rᵀ S Sᵀ R. Turn, mirror, swap or sort covariances and positions together.
    """
    alignment = measure_alignment(sample)
    if alignment is None or alignment.deviation <= _UNRELATED_ROUGHNESS:
        return
    actual = (
        f"deviation {alignment.deviation:.2f} of the orientation from the neighbours' "
        f"{alignment.shape}"
    )
    axis_order = _find_axis_order(sample, alignment)
    if axis_order:
        actual += f"; it would fit if the axes of the covariances were {axis_order}"
    expected = f"below {_UNRELATED_ROUGHNESS}: 0 is along the surface or strand, 1 is random"
    location = Location(sample.emission.rows_label, "covariance")
    yield Violation(
        where=location,
        expected=expected,
        actual=actual,
        certainty="possible",
        statistic=Statistic("deviation", alignment.deviation, 0.0, _UNRELATED_ROUGHNESS),
    )


def _find_axis_order(sample: DrawnSample, alignment: Alignment) -> str:
    """Return the axis permutation that aligns Gaussians with their neighbours; empty if none."""
    axis = alignment.axis
    is_shape = is_of_shape(sample, axis)
    axis_vectors, scatter = sample.axes[is_shape][:, :, axis], sample.scatter[is_shape]
    limit = sample.scatter_eigenvalues[is_shape, axis].mean()
    best_deviation, name = MAX_FITTING_DEVIATION, ""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=2):
            turned_axes = axis_vectors[:, order] * (*signs, 1.0)
            share = np.einsum("mi,mij,mj->m", turned_axes, scatter, turned_axes).mean()
            deviation = float((share - limit) / (RANDOM_DEVIATION - limit))
            if deviation < best_deviation:
                words = zip((*signs, 1.0), order, strict=True)
                best_deviation, name = (
                    deviation,
                    " ".join(f"{'-' * (s < 0)}{'xyz'[i]}" for s, i in words),
                )
    return name


@rule("GV042", Severity.WARNING, needs=VALID_ROWS)
def covariance_is_rotated(sample: DrawnSample) -> Iterator[Violation]:
    """Long Gaussians are all aligned with x, y and z only if lines of neighbours are aligned, too.

    Why:
        Off-diagonal entries that are exactly 0 in all rows mean that the rotation was left out: the
        diagonal alone was written, and every Gaussian points along an axis.

    Hint:
        Build R S Sᵀ Rᵀ of scales and quaternion, and write all six entries. If the scene is made of
        upright boxes, ignore this rule.
    """
    upper = sample.even_rows[:, 4:]
    aligned_share = float((upper[:, [1, 2, 4]] == 0).all(axis=1).mean())
    if aligned_share < _MAX_ALIGNED_SHARE:
        return
    alignment = measure_alignment(sample)
    variances = upper[:, [0, 3, 5]]
    aspect_ratio = np.sqrt(
        variances.max(axis=1) / np.maximum(variances.min(axis=1), np.finfo(float).tiny)
    )
    if alignment is not None and alignment.deviation <= _UNRELATED_ROUGHNESS:
        return
    if alignment is None and np.median(aspect_ratio) < _MIN_ASPECT_RATIO:
        return
    actual = (
        f"all off-diagonal entries are 0 in {aligned_share:.0%} of {len(upper)} rows, "
        f"whose longest axis is {_median_of_values(aspect_ratio):.3g} times the shortest"
    )
    expected = "rotated covariances, or axes along the surface of the neighbours"
    location = Location(sample.emission.rows_label, "covariance")
    yield Violation(
        where=location,
        expected=expected,
        actual=actual,
        certainty="possible",
        statistic=Statistic("share of rows along the axes", aligned_share, 0.0, _MAX_ALIGNED_SHARE),
    )


def _median_of_values(values: Float[np.ndarray, " n"]) -> float:
    return float(np.median(values))

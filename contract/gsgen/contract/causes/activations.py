"""Explains opacities, colours and variances out of range by the first repair that helps."""

__all__ = ["explain_opacity", "explain_rgb", "explain_variances"]

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.causes.readings import EIGENVALUE_SLACK
from gsgen.contract.spec.geometry import smallest_eigenvalue
from gsgen.contract.spec.layout import CULL_OPACITY
from gsgen.contract.spec.spherical_harmonics import SH_DC

# Shares of values that a mistake explains; the rest are outliers.
_MIN_INTEGER_SHARE = 0.995
_RANGE_SLACK = 1e-3
_COLOR_SLACK = 1e-2
_MAX_BYTE = 255.0
_MAX_PERCENT = 100.0
# Natural logarithms of scales, or of their squares, that scenes have.
_LOWEST_LOG, _HIGHEST_LOG = -40.0, 8.0
# Logarithms of lengths below one unit are negative, as are nearly all of a scene.
_MAJORITY_SHARE = 0.9
# Of logits, at least this share lies outside [0, 1]; the sigmoid would spoil the others.
_MIN_LOGIT_SHARE = 0.4
# Of percent, at least this share of the positive values lies above 1: others are hardly visible.
_MIN_PERCENT_SHARE = 0.9
# A network that lacks a clamp goes beyond the range by this much at most.
_MAX_OVERSHOOT = 0.5
# Fewer values than this fit any mistake by chance.
_MIN_VALUES = 8

# Words for the mistake and its repair, whether the values look like it, and the repair.
_Repair = tuple[str, bool, Callable[[np.ndarray], np.ndarray]]


def _first_repair(
    values: np.ndarray, repairs: Sequence[_Repair], is_valid: Callable[[np.ndarray], bool]
) -> tuple[str, str] | None:
    """Return mistake and repair in words, of the first likely repair that makes values valid."""
    with np.errstate(all="ignore"):
        for words, is_likely, repair in repairs:
            if is_likely and is_valid(repair(values)):
                mistake, repair_words = words.split(": ")
                return mistake, repair_words
    return None


def explain_opacity(values: Float[np.ndarray, " n"]) -> tuple[str, str] | None:
    """Return the likely cause of opacities outside [0, 1] and its repair; None if none helps.

    Args:
        values: Finite opacities of live rows, [n].
    """
    low, high = _finite_range(values)
    outside_share = float(np.mean((values < 0) | (values > 1)))
    is_positive, is_signed_unit = low >= -_RANGE_SLACK, low >= -1 - _RANGE_SLACK and high <= 1.001
    is_near = low >= -_MAX_OVERSHOOT and high <= 1 + _MAX_OVERSHOOT
    is_mostly_above = (values > 1).sum() >= _MIN_PERCENT_SHARE * max((values > 0).sum(), 1)
    repairs: list[_Repair] = [
        (_BYTES, is_positive and _are_bytes(values), lambda x: x / 255),
        (
            "these look like percent, 0 to 100: divide by 100",
            is_positive and is_mostly_above and 2 < high <= _MAX_PERCENT + _RANGE_SLACK,
            lambda x: x / 100,
        ),
        (
            "values within [-1, 1] suggest tanh in place of the sigmoid: use (x + 1) / 2",
            is_signed_unit,
            lambda x: (x + 1) / 2,
        ),
        (
            "values on both sides suggest logits: apply the sigmoid",
            not is_positive and outside_share > _MIN_LOGIT_SHARE,
            _sigmoid,
        ),
        (_CLAMP, is_positive and is_near, lambda x: np.clip(x, 0, 1)),
        (
            "a few values on both sides suggest a missing clamp: clamp them",
            outside_share <= _MIN_LOGIT_SHARE and is_near,
            lambda x: np.clip(x, 0, 1),
        ),
    ]

    def is_valid(opacity: np.ndarray) -> bool:
        is_in_range = (opacity >= -_RANGE_SLACK) & (opacity <= 1 + _RANGE_SLACK)
        return bool(is_in_range.all() and (opacity >= CULL_OPACITY).any())

    return _first_repair(values, repairs, is_valid)


def explain_rgb(
    values: Float[np.ndarray, "n 3"], low: float = 0.0, high: float = 1.0
) -> tuple[str, str] | None:
    """Return the likely cause of RGB outside its range and its repair; None if none helps.

    Args:
        values: Finite colours of drawn rows, [n, 3].
        low: The lowest valid value.
        high: The highest valid value.
    """
    least, most = _finite_range(values)
    is_positive = least >= -_RANGE_SLACK
    reaches_ends = least < -0.9 or most > 0.9
    is_signed_unit = least >= -1 - _RANGE_SLACK and most <= 1 + _RANGE_SLACK and reaches_ends
    repairs: list[_Repair] = [
        (_BYTES, is_positive and _are_bytes(values), lambda x: x / 255),
        (_CLAMP, is_positive and most <= high + _MAX_OVERSHOOT, lambda x: np.clip(x, low, high)),
        (
            "values within [-1, 1] suggest signed colours: use (x + 1) / 2",
            is_signed_unit,
            lambda x: (x + 1) / 2,
        ),
        (
            "values on both sides suggest SH coefficients: use 0.5 + 0.28209479 · f_dc",
            not is_positive,
            lambda x: 0.5 + SH_DC * x,
        ),
        (
            "values on both sides suggest logits: apply the sigmoid activation",
            not is_positive,
            _sigmoid,
        ),
    ]

    def is_valid(rgb: np.ndarray) -> bool:
        is_in_range = (rgb >= low - _COLOR_SLACK) & (rgb <= high + _COLOR_SLACK)
        return bool(is_in_range.all())

    return _first_repair(values, repairs, is_valid)


def explain_variances(covariance: Float[np.ndarray, "n 6"]) -> tuple[str, str] | None:
    """Return the likely cause of negative variances and its repair; None if none helps.

    Args:
        covariance: Finite xx, xy, xz, yy, yz, zz of drawn rows, [n, 6].
    """
    diagonal = covariance[:, [0, 3, 5]]
    if len(covariance) < _MIN_VALUES:
        return None
    is_mostly_negative = bool(np.mean(diagonal < 0) > _MAJORITY_SHARE)
    are_logs = diagonal.min() >= _LOWEST_LOG and diagonal.max() <= _HIGHEST_LOG
    diagonal_mask = np.array([1, 0, 0, 1, 0, 1], bool)
    repairs: list[_Repair] = [
        (
            "nearly all are negative: negate the covariance",
            is_mostly_negative and bool(covariance[:, ~diagonal_mask].any()),
            lambda x: -x,
        ),
        (
            "these look like logarithms of scales: apply exp, then square",
            is_mostly_negative and bool(are_logs),
            lambda x: np.where(diagonal_mask, np.exp(2 * x), x),
        ),
        ("nearly all are negative: negate the covariance", is_mostly_negative, lambda x: -x),
    ]

    def is_valid(upper: np.ndarray) -> bool:
        size = np.abs(upper[:, [0, 3, 5]]).sum(axis=1)
        return bool((smallest_eigenvalue(upper) >= -EIGENVALUE_SLACK * size).all())

    return _first_repair(covariance.astype(np.float64), repairs, is_valid)


_BYTES: Final = "these are bytes from 0 to 255: divide by 255"
_CLAMP: Final = "values above 1 alone suggest a missing clamp: clamp them"


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return np.asarray(1 / (1 + np.exp(-values)))


def _finite_range(values: Float[np.ndarray, "..."]) -> tuple[float, float]:
    return float(values.min(initial=0.0)), float(values.max(initial=0.0))


def _are_bytes(values: Float[np.ndarray, "..."]) -> bool:
    """Return whether values look like bytes: nearly all whole, up to 255, and some far above 1."""
    if values.size < _MIN_VALUES or not 2 < values.max() <= _MAX_BYTE:
        return False
    return bool(np.mean(values == np.round(values)) >= _MIN_INTEGER_SHARE)

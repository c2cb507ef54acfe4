"""Diagnoses the usual mistakes behind opacities or colours outside [0, 1]."""

__all__ = ["diagnose_opacity", "diagnose_rgb", "diagnose_variances"]

import numpy as np

from gsgen.contract._array_types import Float

# Shares of values that a mistake explains; the rest are outliers.
_MIN_INTEGER_SHARE = 0.995
_RANGE_SLACK = 1e-3
_MAX_BYTE = 255.0
_MAX_PERCENT = 100.0
# Natural logarithms of scales, or of their squares, that scenes have.
_LOWEST_LOG, _HIGHEST_LOG = -40.0, 8.0
# Logarithms of lengths below one unit are negative, as are nearly all of a scene.
_MAJORITY_SHARE = 0.9
# Fewer values than this fit any mistake by chance.
_MIN_VALUES = 8


def diagnose_opacity(values: Float[np.ndarray, " n"]) -> str:
    """Return the likely cause of opacities outside [0, 1] and its repair; empty if unclear.

    Args:
        values: Finite opacities of live rows, [n].
    """
    low, high = _finite_range(values)
    if low >= -_RANGE_SLACK and _are_bytes(values):
        return "these are bytes from 0 to 255: divide by 255"
    if low >= -_RANGE_SLACK and 2 < high <= _MAX_PERCENT + _RANGE_SLACK:
        return "these look like percent, 0 to 100: divide by 100"
    if -1 - _RANGE_SLACK <= low < -_RANGE_SLACK and high <= 1 + _RANGE_SLACK:
        return "values within [-1, 1] suggest tanh in place of the sigmoid: negative opacity"
    if low < -_RANGE_SLACK:
        return "values on both sides suggest logits: apply the sigmoid"
    return "values above 1 alone suggest a missing clamp"


def diagnose_rgb(values: Float[np.ndarray, "n 3"]) -> str:
    """Return the likely cause of RGB outside [0, 1] and its repair; empty if unclear.

    Args:
        values: Finite colours of drawn rows, [n, 3].
    """
    low, high = _finite_range(values)
    if low >= -_RANGE_SLACK and _are_bytes(values):
        return "these are bytes from 0 to 255: divide by 255"
    if low >= -_RANGE_SLACK:
        return "values above 1 alone suggest a missing clamp"
    if low >= -1 - _RANGE_SLACK and high <= 1 + _RANGE_SLACK and (low < -0.9 or high > 0.9):
        return "values within [-1, 1] suggest signed colours: use (x + 1) / 2"
    return (
        "values on both sides suggest SH coefficients (0.5 + 0.28209479 · f_dc) "
        "or logits (apply the sigmoid activation)"
    )


def diagnose_variances(values: Float[np.ndarray, "n 3"]) -> str:
    """Return the likely cause of negative variances, for a message; empty if unclear.

    Args:
        values: Finite xx, yy, zz of drawn rows, [n, 3].
    """
    if len(values) < _MIN_VALUES:
        return ""
    is_mostly_negative = bool(np.mean(values < 0) > _MAJORITY_SHARE)
    if is_mostly_negative and values.min() >= _LOWEST_LOG and values.max() <= _HIGHEST_LOG:
        return "; these look like logarithms of scales: apply exp, then square"
    if is_mostly_negative:
        return "; nearly all are negative: the sign was turned"
    return ""


def _finite_range(values: Float[np.ndarray, "..."]) -> tuple[float, float]:
    return float(values.min(initial=0.0)), float(values.max(initial=0.0))


def _are_bytes(values: Float[np.ndarray, "..."]) -> bool:
    """Return whether values look like bytes: nearly all whole, up to 255, and some far above 1."""
    if values.size < _MIN_VALUES or not 2 < values.max() <= _MAX_BYTE:
        return False
    return bool(np.mean(values == np.round(values)) >= _MIN_INTEGER_SHARE)

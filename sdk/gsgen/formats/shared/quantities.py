"""Arithmetic that splat formats share: activations, unit quaternions, rounding."""

import math
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, Integer, UInt8

SH_C0: Final = 0.5 / math.sqrt(math.pi)
"""The harmonic of degree 0: colour = 0.5 + SH_C0 · coefficient."""


def sigmoid(logit: Float[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    """Return the sigmoid 1 / (1 + e^-x) of each logit x."""
    with np.errstate(over="ignore"):  # e^inf is inf, and 1 / inf is the correct 0
        return np.asarray(1 / (1 + np.exp(-logit.astype(np.float64))), np.float32)


def logit(opacity: Float[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    """Return the logit, the inverse of ``sigmoid``: 0 becomes -inf and 1 becomes inf."""
    opacity64 = opacity.astype(np.float64)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(opacity64) - np.log1p(-opacity64), np.float32)


def log(scale: Float[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    """Return the natural logarithm of an array; 0 becomes -inf."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(scale.astype(np.float64)), np.float32)


def unit(rotation: Float[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 4"]:
    """Normalise quaternions; a quaternion of length zero becomes the identity (1, 0, 0, 0)."""
    columns = np.array(rotation.T, np.float64, order="C")  # whole columns are fast
    columns /= np.maximum(np.abs(columns).max(axis=0), np.finfo(np.float64).tiny)
    length = np.sqrt((columns * columns).sum(axis=0))
    columns /= np.maximum(length, 0.5)
    columns[:, ~(length > 0)] = np.eye(4)[:, :1]
    return np.ascontiguousarray(columns.T, np.float32)


def unit_or_zero(rotation: Float[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 4"]:
    """Normalise quaternions of a file; one of length zero stays so, which is not a valid row."""
    quaternions = unit(rotation)
    quaternions[(rotation == 0).all(axis=1)] = 0
    return quaternions


def rounded(values: Float[np.ndarray, "..."], low: int, high: int) -> Integer[np.ndarray, "..."]:
    """Round ``values`` to the nearest whole numbers from ``low`` to ``high``."""
    return np.asarray(np.clip(np.rint(values), low, high), np.int64)


def to_bytes(values: Float[np.ndarray, "..."]) -> UInt8[np.ndarray, "..."]:
    """Round ``values`` to whole numbers from 0 to 255."""
    return rounded(values, 0, 255).astype(np.uint8)


def quaternions_from_largest(
    largest: Integer[np.ndarray, " n"], smaller: Float[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 4"]:
    """Rebuild unit quaternions from their three components other than the largest.

    Args:
        largest: The index of the component that is not stored; it is positive.
        smaller: The other components, in order of their indices.
    """
    rows = np.arange(len(largest))
    quaternions = np.empty((len(largest), 4), np.float64)
    for index in range(3):
        quaternions[rows, index + (index >= largest)] = smaller[:, index]
    squares = np.square(smaller.astype(np.float64)).sum(axis=1)
    quaternions[rows, largest] = np.sqrt(np.maximum(1 - squares, 0))
    return quaternions.astype(np.float32)


def without_largest(
    rotation: Float[np.ndarray, "n 4"],
) -> tuple[Integer[np.ndarray, " n"], Float32[np.ndarray, "n 3"]]:
    """Return a quaternion's three components other than the largest, and the largest's index."""
    largest = np.abs(rotation).argmax(axis=1)
    rows = np.arange(len(rotation))
    positive_quaternion = rotation * np.where(rotation[rows, largest] < 0, -1, 1)[:, None]
    indices = np.arange(3)
    smaller = indices + (indices >= largest[:, None])
    return largest, np.asarray(np.take_along_axis(positive_quaternion, smaller, axis=1), np.float32)


def rotations(matrices: Float64[np.ndarray, "n 3 3"]) -> Float32[np.ndarray, "n 4"]:
    """Return the unit quaternions (w, x, y, z) of rotation matrices.

    The four rows below are 4 times the quaternion times one of its components (Shepperd 1978).
    """
    m = matrices
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    table = np.stack(
        [
            np.stack([1 + xx + yy + zz, wx, wy, wz], axis=-1),
            np.stack([wx, 1 + xx - yy - zz, xy, xz], axis=-1),
            np.stack([wy, xy, 1 - xx + yy - zz, yz], axis=-1),
            np.stack([wz, xz, yz, 1 - xx - yy + zz], axis=-1),
        ],
        axis=1,
    )
    best_column = np.argmax(table[:, range(4), range(4)], axis=1)
    return unit(table[np.arange(len(table)), best_column])

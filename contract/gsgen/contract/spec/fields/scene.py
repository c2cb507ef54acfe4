"""Manifest fields for coordinate frame, bounds and blending of a model's Gaussians."""

__all__ = ["Bounds", "Space", "Tolerances", "WeightedSum"]

from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import Annotated, Literal

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.fields.values import Fraction, PositiveFloat


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """The coordinate frame of Gaussians, cameras and bounds."""

    handedness: Literal["right"] = "right"
    up: Annotated[
        Literal["+x", "-x", "+y", "-y", "+z", "-z"], Hint(text="The world's upward axis.")
    ] = "-y"
    unit: Annotated[
        Literal["metre", "arbitrary"],
        Hint(text="What one unit of length is; SfM scenes: arbitrary."),
    ] = "arbitrary"
    matrix_order: Annotated[
        Literal["column", "row"],
        Hint(
            text="`column`: the [4,4] tensor holds Mᵀ, as column-major bytes do. `row`: it holds M."
        ),
    ] = "column"
    origin: Annotated[
        tuple[float, float, float] | None,
        Hint(text="Where the local origin lies in the author's world, in units, as float64."),
    ] = None
    metres_per_unit: Annotated[
        PositiveFloat | None, Hint(text="Length of one unit, in metres.")
    ] = None


@dataclass(frozen=True, slots=True)
class Bounds:
    """An axis-aligned box of all Gaussian centres for all inputs, checked with test inputs."""

    min: Annotated[tuple[float, float, float], Hint(text="Lower corner, x y z.")]
    max: Annotated[tuple[float, float, float], Hint(text="Upper corner, x y z.")]

    @classmethod
    def from_points(cls, points: Float[np.ndarray, "n 3"], margin: float) -> "Bounds | None":
        """Return the bounding box of all finite points, or None without any finite point.

        Args:
            points: Centres, in local units.
            margin: How much wider the box is, as a share of its size.
        """
        float64_points = np.asarray(points, np.float64)
        finite_points = float64_points[np.isfinite(float64_points).all(axis=1)]
        if not len(finite_points):
            return None
        low, high = finite_points.min(axis=0), finite_points.max(axis=0)
        room = margin * (high - low) + 1e-6
        # Rounding to nearest must not cut off a point of a flat box far from the origin.
        first = [
            min(float(f"{value:.6g}"), _round_decimal(lower_value, ROUND_FLOOR))
            for value, lower_value in zip(low - room, low, strict=True)
        ]
        last = [
            max(float(f"{value:.6g}"), _round_decimal(upper_value, ROUND_CEILING))
            for value, upper_value in zip(high + room, high, strict=True)
        ]
        return cls((first[0], first[1], first[2]), (last[0], last[1], last[2]))


def _round_decimal(value: float, rounding: str) -> float:
    """Round a number up or down to 6 significant digits."""
    return float(Context(prec=6, rounding=rounding).create_decimal(float(value)))


@dataclass(frozen=True, slots=True)
class WeightedSum:
    """Parameters of weighted-sum blending per cell (group of Gaussians), for `blend: wsr`."""

    background: Annotated[Fraction, Hint(text="Weight of the background.")]
    depth_range: Annotated[
        PositiveFloat | None,
        Hint(text="Depth at which weights reach 0, in units of length; absent: they do not fall."),
    ] = None
    opacity_divisor: Annotated[
        PositiveFloat, Hint(text="What opacity is divided by before it takes light away.")
    ] = 1.0


@dataclass(frozen=True, slots=True)
class Tolerances:
    """The largest allowed differences between two runs of the model, each field in its unit."""

    position: Annotated[Fraction, Hint(text="In standard deviations of the Gaussian.")] = 1e-3
    covariance: Annotated[Fraction, Hint(text="Relative to the covariance's trace.")] = 1e-3
    opacity: Annotated[Fraction, Hint(text="Absolute.")] = 2e-3
    appearance: Annotated[Fraction, Hint(text="Absolute, of the colour seen from a direction.")] = (
        2e-3
    )

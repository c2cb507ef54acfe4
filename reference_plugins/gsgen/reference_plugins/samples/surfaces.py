"""Samples surfaces of revolution, discs and blades as flat Gaussians with normals and colours."""

__all__ = ["Cloud", "grass_blades", "join", "on_disc", "on_ellipsoid", "on_lathe"]

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "n 3"]
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))  # radians; successive points of a sunflower's head


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """Unlit Gaussians with normals and albedo; y is up, lengths are in metres.

    Attributes:
        position: Centres.
        normal: Unit normals, along which the Gaussians are thin.
        along: Unit vectors of the first axis in the surface.
        scale: Standard deviations along ``along``, across it and along the normal.
        color: Albedo, linear, from 0 to 1.
        translucency: Share of the light that passes through thin leaves from behind.
    """

    position: Points
    normal: Points
    along: Points
    scale: Points
    color: Points
    translucency: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.position)

    def moved(self, offset: Sequence[float]) -> "Cloud":
        """Return the cloud of Gaussians shifted by ``offset``."""
        return replace(self, position=self.position + np.asarray(offset))


def join(clouds: Sequence[Cloud]) -> Cloud:
    """Concatenate the Gaussians of several clouds."""
    return Cloud(
        **{
            name: np.concatenate([getattr(cloud, name) for cloud in clouds])
            for name in ("position", "normal", "along", "scale", "color", "translucency")
        }
    )


def _cloud(
    position: Points, normal: Points, color: Points, size: float, *, translucency: float = 0.0
) -> Cloud:
    """Return Gaussians as round discs of standard deviation ``size``, facing ``normal``."""
    reference_axis = np.where(np.abs(normal[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    along = np.cross(reference_axis, normal)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return Cloud(
        position=position,
        normal=normal,
        along=along,
        scale=np.tile([size, size, 0.25 * size], (len(position), 1)),
        color=np.broadcast_to(color, position.shape),
        translucency=np.full(len(position), translucency),
    )


def on_disc(count: int, radius: float, color: Points, *, hole_radius: float = 0.0) -> Cloud:
    """Return ``count`` Gaussians on a horizontal disc around the origin that faces up."""
    index = np.arange(count) + 0.5
    distance = np.sqrt(hole_radius**2 + (radius**2 - hole_radius**2) * index / count)
    angle = _GOLDEN_ANGLE * index
    position = np.stack(
        [distance * np.cos(angle), np.zeros(count), distance * np.sin(angle)], axis=1
    )
    spacing = np.sqrt(np.pi * (radius**2 - hole_radius**2) / count)
    return _cloud(position, np.tile([0.0, 1.0, 0.0], (count, 1)), color, 0.6 * spacing)


def on_lathe(count: int, profile: Sequence[tuple[float, float]], color: Points) -> Cloud:
    """Return ``count`` Gaussians on the surface that a profile of (radius, height) sweeps out.

    The profile runs upwards with the outside on its right.
    """
    corners = np.asarray(profile)
    steps = np.diff(corners, axis=0)
    area = np.linalg.norm(steps, axis=1) * (corners[1:, 0] + corners[:-1, 0]) / 2
    cumulative_area = np.concatenate([[0.0], np.cumsum(area)])
    index = np.arange(count) + 0.5
    area_position = index / count * cumulative_area[-1]
    segment = np.clip(np.searchsorted(cumulative_area, area_position) - 1, 0, len(steps) - 1)
    share = (area_position - cumulative_area[segment]) / np.maximum(area[segment], 1e-12)
    radius, height = (corners[segment] + share[:, None] * steps[segment]).T
    outward_part, upward_part = steps[segment, 1], -steps[segment, 0]
    angle = _GOLDEN_ANGLE * index
    radial_direction = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
    normal = outward_part[:, None] * radial_direction + upward_part[:, None] * np.array(
        [0.0, 1.0, 0.0]
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    position = radius[:, None] * radial_direction + height[:, None] * np.array([0.0, 1.0, 0.0])
    return _cloud(position, normal, color, 0.6 * np.sqrt(2 * np.pi * cumulative_area[-1] / count))


def on_ellipsoid(
    count: int,
    radii: Sequence[float],
    color: Points,
    rng: np.random.Generator,
    *,
    depth: float = 0.15,
    size: float = 0.02,
) -> Cloud:
    """Return ``count`` flat Gaussians, as leaves, in the outer shell of an ellipsoid."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = direction * radii * (1 - depth * rng.random((count, 1)) ** 2)
    normal = direction / np.asarray(radii) * float(np.mean(radii)) + 0.3 * rng.normal(
        size=(count, 3)
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    leaves = _cloud(position, normal, color, size, translucency=0.35)
    shape = np.array([1.5, 0.8, 0.25]) * np.exp(0.25 * rng.normal(size=(count, 1)))
    return replace(leaves, scale=size * shape)


def grass_blades(
    roots: Points, length: Float[np.ndarray, " n"], color: Points, rng: np.random.Generator
) -> Cloud:
    """Return a long upright Gaussian, as a blade of grass, at each root position."""
    count = len(roots)
    lean_direction = np.stack(
        [rng.normal(0, 0.35, count), np.ones(count), rng.normal(0, 0.35, count)], 1
    )
    lean_direction /= np.linalg.norm(lean_direction, axis=1, keepdims=True)
    side_direction = rng.normal(size=(count, 3))
    normal = np.cross(lean_direction, side_direction)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half_length = 0.5 * length[:, None]
    return Cloud(
        position=roots + half_length * lean_direction,
        normal=normal,
        along=lean_direction,
        scale=np.concatenate(
            [0.6 * half_length, 0.12 * half_length + 0.002, 0.03 * half_length + 0.001], axis=1
        ),
        color=np.broadcast_to(color, roots.shape),
        translucency=np.full(count, 0.5),
    )

"""Transforms of the root tile, which place a scene in the world or on the globe."""

__all__ = ["Z_UP_FROM_SCENE", "globe_transform", "read_transform", "upright_transform"]

import json
import math
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.errors import ConfigInvalid
from gsgen.formats.shared.splats import DEFAULT_UP
from gsgen.tiles.format.volumes import ecef

Z_UP_FROM_SCENE: Final[Float64[np.ndarray, "4 4"]] = np.array(
    [[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
)
"""Scene → world: a scene has y down and z forward, the world of 3D Tiles has z up."""

_SIMILARITY_TOLERANCE: Final = 1e-6


def upright_transform() -> tuple[float, ...]:
    """Return the 4×4 transform from scene axes (y down) to world axes (z up), column-major."""
    return _columns(Z_UP_FROM_SCENE)


def turned_transform(
    transform: tuple[float, ...], up: tuple[float, float, float]
) -> tuple[float, ...]:
    """Return a transform for scenes of 3DGS (-y up) as one for scenes of another upward direction.

    Args:
        transform: Scene → world, column-major.
        up: The upward direction of the scene, a unit vector.
    """
    turn = np.eye(4)
    axis = np.cross(up, DEFAULT_UP)
    cosine = float(np.dot(up, DEFAULT_UP))
    if cosine < -1 + 1e-9:  # upside down: half a turn about x
        turn = np.diag([1.0, -1.0, -1.0, 1.0])
    elif np.any(axis):
        cross_matrix = np.array(
            [[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]]
        )
        turn[:3, :3] += cross_matrix + cross_matrix @ cross_matrix / (
            1 + cosine
        )  # Rodrigues' formula
    return _columns(np.array(transform).reshape(4, 4).T @ turn)


def moved_transform(
    transform: tuple[float, ...], origin: tuple[float, float, float]
) -> tuple[float, ...]:
    """Return a transform of a scene as one for positions relative to an origin, column-major."""
    matrix = np.array(transform).reshape(4, 4).T
    matrix[:3, 3] += matrix[:3, :3] @ origin
    return _columns(matrix)


def globe_transform(longitude: float, latitude: float, height: float) -> tuple[float, ...]:
    """Return the transform that puts the scene's origin on the globe, upright, x to the east.

    Args:
        longitude: In degrees.
        latitude: In degrees.
        height: Over the ellipsoid of WGS 84, in metres.
    """
    limits = {"--lon": (longitude, 180.0), "--lat": (latitude, 90.0), "--height": (height, 1e7)}
    for option, (value, limit) in limits.items():
        if not abs(value) <= limit:
            raise ConfigInvalid(f"is {value}; expected -{limit:g} to {limit:g}", where=option)
    longitude_radians, north = math.radians(longitude), math.radians(latitude)
    sin_east, cos_east, sin_north, cos_north = (
        math.sin(longitude_radians),
        math.cos(longitude_radians),
        math.sin(north),
        math.cos(north),
    )
    matrix = np.eye(4)
    matrix[:3, 0] = -sin_east, cos_east, 0
    matrix[:3, 1] = -sin_north * cos_east, -sin_north * sin_east, cos_north
    matrix[:3, 2] = cos_north * cos_east, cos_north * sin_east, sin_north
    matrix[:3, 3] = ecef(np.array([longitude_radians]), np.array([north]), np.array([height]))[0]
    return _columns(matrix @ Z_UP_FROM_SCENE)


def read_transform(path: Path) -> tuple[float, ...]:
    """Parse a scene → world transform from JSON: an array of 16 numbers, or of 4 rows of 4.

    Sixteen numbers are column by column, as in ``tileset.json``; rows are rows.
    """
    expected = "a JSON array of 16 numbers (column by column), or of 4 rows of 4"
    try:
        value = np.asarray(json.loads(path.read_text("utf-8")), np.float64)
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(path)) from error
    except (ValueError, TypeError) as error:
        raise ConfigInvalid(
            f"cannot be read ({error}); expected {expected}", where=str(path)
        ) from error
    if value.shape not in ((16,), (4, 4)):
        shape = "×".join(map(str, value.shape))
        raise ConfigInvalid(f"has {shape} numbers; expected {expected}", where=str(path))
    matrix = value if value.shape == (4, 4) else value.reshape(4, 4).T
    linear = matrix[:3, :3]
    if np.isfinite(matrix).all():
        scale = float(np.cbrt(max(np.linalg.det(linear), 0.0)))
        error_size = float(np.abs(linear @ linear.T - scale**2 * np.eye(3)).max())
        is_similarity = scale > 0 and error_size <= _SIMILARITY_TOLERANCE * scale**2
        if is_similarity and np.array_equal(matrix[3], [0, 0, 0, 1]):
            return _columns(matrix)
    raise ConfigInvalid(
        f"{matrix.tolist()} is not a similarity: a rotation, one positive scale, a translation",
        where=str(path),
        hint="The last row is 0 0 0 1 and the other columns are at right angles.",
    )


def _columns(matrix: Float64[np.ndarray, "4 4"]) -> tuple[float, ...]:
    return tuple(float(value) + 0.0 for value in matrix.T.ravel())

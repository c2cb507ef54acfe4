"""Measures the splats of a tile's content: splats outside volumes, and invalid numbers."""

__all__ = ["ContentValues", "OutsideSplats", "measure_content"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float64

from gsgen.contract.spec.geometry import COVARIANCE_INDEX, covariance_upper, symmetric
from gsgen.formats.glb.accessors import read_accessor
from gsgen.formats.glb.container import Container
from gsgen.formats.glb.glb import scene_primitives
from gsgen.formats.glb.splats import EXTENSION_NAME
from gsgen.formats.shared.errors import FormatError
from gsgen.formats.shared.splat_values import require_drawable
from gsgen.formats.shared.splats import Splats
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.volumes import Box, Volume
from gsgen.tiles.gltf.encoding import EXTENT_SIGMAS
from gsgen.tiles.gltf.placement import PlacedSplats

_SIZE_TOLERANCE: Final = 1e-3
_RADIUS_TOLERANCE: Final = 0.04  # half a step of a scale in SPZ, and of its rotation
_UNIT_TOLERANCE: Final = 0.02
_MIN_TOLERANCE: Final = 1e-6


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class OutsideSplats:
    """The splats of a tile's content that reach out of a bounding volume.

    Attributes:
        count: How many do, at 3σ.
        total: Of how many.
        row: The one that reaches out farthest.
        distance: How far, in units of the root frame.
        centers: How many have their centre outside.
    """

    count: int
    total: int
    row: int
    distance: float
    centers: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ContentValues:
    """A tile's splats that leave the content's volume, or have their centre in no child's volume.

    Attributes:
        outside: Those that reach out of its volume; None where none does.
        uncovered: Those whose centre lies in no child of a tile that children replace.
    """

    outside: OutsideSplats | None = None
    uncovered: OutsideSplats | None = None


def measure_content(
    parts: list[PlacedSplats],
    volume: Volume | None,
    children: list[Volume],
    margin: float,
    to_world: Float64[np.ndarray, "4 4"],
) -> ContentValues:
    """Measure the splats of a tile's content against bounding volumes.

    Args:
        parts: In the root frame.
        volume: Of the content, in the world; None without a volume.
        children: The volumes of the tiles that replace it, in the world; may be empty.
        margin: How far the children's volumes are grown, in units of the world.
        to_world: From the root frame to the world, where volumes are.
    """
    outside = uncovered = None
    if volume is not None:
        outside = _merge_outside_splats([_outside_volume(part, volume, to_world) for part in parts])
    if children:
        uncovered = _merge_outside_splats(
            [_outside_children(part, children, margin, to_world) for part in parts]
        )
    return ContentValues(outside=outside, uncovered=uncovered)


def _outside_volume(
    part: PlacedSplats, volume: Volume, to_world: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Return how far each splat's 3σ ellipsoid leaves a volume, and whether the centre does.

    1. Box: along each axis u, |u·(μ − c)| + 3 √(uᵀ Σ u) beyond the half length.
    2. Sphere and region: the distance of the centre, plus 3σ along the direction of the sphere's
       centre; for a region the smallest σ, as its faces are curved.
    """
    linear = to_world[:3, :3]
    centers = part.positions() @ linear.T + to_world[:3, 3]
    allowed_distance = _SIZE_TOLERANCE * volume.size + _MIN_TOLERANCE
    covariances = covariance_upper(
        np.exp(part.splats.log_scale.astype(np.float64)), part.splats.rotation
    )
    center_overshoot = volume.outside(centers)
    if isinstance(volume, Box):
        lengths = np.linalg.norm(volume.half_axes, axis=1)
        axes = volume.half_axes / np.where(lengths > 0, lengths, 1)[:, None]
        # uᵀ M Σ Mᵀ u is linear in the six elements of Σ: those off the diagonal count twice.
        rows, columns = COVARIANCE_INDEX
        inner = axes @ linear
        weights = inner[:, rows] * inner[:, columns] * np.where(np.equal(rows, columns), 1, 2)
        reach = EXTENT_SIGMAS * np.sqrt(np.maximum(weights @ covariances.T, 0))
        along = np.abs(axes @ (centers - volume.center).T)
        overshoot = (along + reach * (1 - _RADIUS_TOLERANCE) - lengths[:, None]).max(axis=0)
    else:
        least = np.linalg.eigvalsh(linear @ symmetric(covariances) @ linear.T)[:, 0]
        reach = EXTENT_SIGMAS * np.sqrt(np.maximum(least, 0))
        overshoot = np.where(
            center_overshoot > 0, center_overshoot + reach * (1 - _RADIUS_TOLERANCE), 0
        )
    return np.where(
        overshoot > allowed_distance, overshoot, 0.0
    ), center_overshoot > allowed_distance


def _outside_children(
    part: PlacedSplats, children: list[Volume], margin: float, to_world: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    centers = part.positions() @ to_world[:3, :3].T + to_world[:3, 3]
    nearest = np.full(len(centers), np.inf)
    for child in children:
        allowed_distance = margin + _SIZE_TOLERANCE * child.size + _MIN_TOLERANCE
        nearest = np.minimum(nearest, np.maximum(child.outside(centers) - allowed_distance, 0))
    return nearest, nearest > 0


def _merge_outside_splats(
    measured: list[tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"]]],
) -> OutsideSplats | None:
    distance = np.concatenate([entry[0] for entry in measured] or [np.zeros(0)])
    centers = np.concatenate([entry[1] for entry in measured] or [np.zeros(0, bool)])
    count = int(np.count_nonzero((distance > 0) | centers))
    if not count:
        return None
    row = int(np.argmax(distance))
    return OutsideSplats(
        count=count,
        total=len(distance),
        row=row,
        distance=float(distance[row]),
        centers=int(np.count_nonzero(centers)),
    )


def check_values(container: Container, decoded: list[Splats], location: str) -> None:
    """Raise if splats have non-finite numbers or quaternions that are not unit."""
    try:
        for splats in decoded:
            if len(splats):
                require_drawable(splats)
        for primitive, _, where in scene_primitives(container):
            index = primitive.get("attributes", {}).get(f"{EXTENSION_NAME}:ROTATION")
            accessor = container.item("accessors", index, where) if index is not None else {}
            if "bufferView" in accessor:
                rotation = read_accessor(container, index, (4,), where)
                _check_unit(rotation.astype(np.float64), f"{location}, {where}")
    except FormatError as error:
        raise TilesetInvalid(
            error.message,
            location=f"{location}, {error.where}",
            expected=error.expected,
            fault=Fault.VALUES,
        ) from error


def _check_unit(rotation: Float64[np.ndarray, "n 4"], location: str) -> None:
    length = np.linalg.norm(rotation, axis=1)
    is_wrong_length = ~(np.abs(length - 1) <= _UNIT_TOLERANCE)
    if is_wrong_length.any():
        first = int(np.argmax(is_wrong_length))
        raise TilesetInvalid(
            f"{np.count_nonzero(is_wrong_length)} of {len(length)} quaternions are not unit, the first "
            f"(row {first}) has length {length[first]:g}",
            location=f"{location}, attribute {EXTENSION_NAME}:ROTATION",
            expected="length 1",
            fault=Fault.VALUES,
        )

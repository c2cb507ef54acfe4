"""Bounding volumes of tiles: boxes, spheres and regions of the globe, in float64."""

__all__ = ["Box", "Region", "Sphere", "Volume", "ecef", "read_volume"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.tiles.format.json_values import JsonObject

Points = Float64[np.ndarray, "n 3"]
Matrix = Float64[np.ndarray, "4 4"]

_EQUATOR_RADIUS: Final = 6378137.0
_POLE_RADIUS: Final = 6356752.314245179
_MAX_LEVEL = 40


@final
@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """An oriented bounding box: a centre and three half axes.

    Attributes:
        center: The middle.
        half_axes: Three vectors from the middle to the faces, as rows.
    """

    center: Float64[np.ndarray, " 3"]
    half_axes: Float64[np.ndarray, "3 3"]

    @property
    def size(self) -> float:
        """The length of the bounding box's diagonal."""
        return 2 * float(np.sqrt(np.square(self.half_axes).sum()))

    def transformed(self, matrix: Matrix) -> "Box":
        """Return the bounding box transformed by a 4×4 matrix."""
        linear = matrix[:3, :3]
        return Box(linear @ self.center + matrix[:3, 3], self.half_axes @ linear.T)

    def samples(self) -> Points:
        """Return the eight corners of the bounding box."""
        signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
        return np.asarray(self.center + signs @ self.half_axes)

    def outside(self, points: Points) -> Float64[np.ndarray, " n"]:
        """Return the largest distance of each point beyond a face of the box; 0 within the box.

        Axes have to be at right angles, as 3D Tiles asks for.
        """
        lengths = np.linalg.norm(self.half_axes, axis=1)
        unit_axes = _unit_axes(self.half_axes, lengths)
        along = np.abs(unit_axes @ (points - self.center).T)  # an axis a row: reductions are fast
        return np.asarray(np.maximum(along - lengths[:, None], 0).max(axis=0))

    def child(self, offsets: tuple[int, ...], level: int) -> "Box":
        """Return a quadtree or octree cell of the box, by the cell's level and coordinates."""
        cell_counts = np.ones(3)
        cell_counts[: len(offsets)] = 2.0 ** min(level, _MAX_LEVEL)
        cells = np.zeros(3)
        cells[: len(offsets)] = offsets
        middle = (2 * cells + 1) / cell_counts - 1
        return Box(self.center + middle @ self.half_axes, self.half_axes / cell_counts[:, None])


@final
@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """A bounding sphere: a centre and a radius.

    Attributes:
        center: The middle.
        radius: In units of its frame.
    """

    center: Float64[np.ndarray, " 3"]
    radius: float

    @property
    def size(self) -> float:
        """The diameter of the bounding sphere."""
        return 2 * self.radius

    def transformed(self, matrix: Matrix) -> "Sphere":
        """Transform a bounding sphere by a 4×4 matrix; the largest scale applies to the radius."""
        linear = matrix[:3, :3]
        scale = float(np.linalg.norm(linear, 2))
        return Sphere(linear @ self.center + matrix[:3, 3], self.radius * scale)

    def samples(self) -> Points:
        """Return the ends of the sphere's diameters along the three axes."""
        return np.asarray(self.center + self.radius * np.vstack([np.eye(3), -np.eye(3)]))

    def outside(self, points: Points) -> Float64[np.ndarray, " n"]:
        """Return the distance of points beyond the sphere's surface; 0 for points within."""
        distance = np.linalg.norm(points - self.center, axis=1)
        return np.asarray(np.maximum(distance - self.radius, 0))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A part of the globe between two parallels, two meridians and two heights.

    Angles are radians, heights metres over the ellipsoid of WGS 84 (EPSG:4979). The
    transform of its tile does not apply to it.
    """

    west: float
    south: float
    east: float
    north: float
    minimum: float
    maximum: float

    @property
    def size(self) -> float:
        """The approximate length of a globe region's diagonal, in metres."""
        corners = self.samples()
        return float(np.linalg.norm(corners.max(axis=0) - corners.min(axis=0)))

    @property
    def width(self) -> float:
        """The angle from a globe region's west to its east, also across the date line."""
        return (
            (self.east - self.west) % (2 * np.pi)
            if self.east < self.west
            else (self.east - self.west)
        )

    def transformed(self, matrix: Matrix) -> "Region":
        """Return the globe region unchanged, since tile transforms do not apply to regions."""
        del matrix
        return self

    def samples(self) -> Points:
        """Return 18 sample points of a globe region, in ECEF coordinates."""
        longitude = self.west + self.width * np.array([0.0, 0.5, 1.0])
        latitude = np.linspace(self.south, self.north, 3)
        grid = np.meshgrid(longitude, latitude, [self.minimum, self.maximum])
        return ecef(*(axis.ravel() for axis in grid))

    def outside(self, points: Points) -> Float64[np.ndarray, " n"]:
        """Return the approximate distance of points (ECEF) outside the region in metres."""
        longitude, latitude, height = geodetic(points)
        middle = self.west + self.width / 2
        longitude_distance = np.abs((longitude - middle + np.pi) % (2 * np.pi) - np.pi)
        east = (
            np.maximum(longitude_distance - self.width / 2, 0) * np.cos(latitude) * _EQUATOR_RADIUS
        )
        north = (
            np.maximum(np.maximum(self.south - latitude, latitude - self.north), 0)
            * _EQUATOR_RADIUS
        )
        up = np.maximum(np.maximum(self.minimum - height, height - self.maximum), 0)
        return np.asarray(np.maximum(np.maximum(east, north), up))

    def child(self, offsets: tuple[int, ...], level: int) -> "Region":
        """Return a quadtree or octree cell of the region, by the cell's level and coordinates."""
        count = 2.0 ** min(level, _MAX_LEVEL)
        width, height = self.width / count, (self.north - self.south) / count
        low, high = self.minimum, self.maximum
        if len(offsets) == 3:
            step = (high - low) / count
            low, high = low + step * offsets[2], low + step * (offsets[2] + 1)
        return Region(
            west=self.west + width * offsets[0],
            south=self.south + height * offsets[1],
            east=self.west + width * (offsets[0] + 1),
            north=self.south + height * (offsets[1] + 1),
            minimum=low,
            maximum=high,
        )


Volume = Box | Sphere | Region


def read_volume(volume: JsonObject) -> Volume:
    """Read a ``boundingVolume`` of 3D Tiles.

    Raises:
        TilesetInvalid: It is neither box, nor sphere, nor region, or its numbers are wrong.
    """
    if "box" in volume:
        numbers = volume.numbers("box", 12)
        return Box(numbers[:3], numbers[3:].reshape(3, 3))
    if "sphere" in volume:
        numbers = volume.numbers("sphere", 4)
        if numbers[3] < 0:
            volume.refuse("sphere", "a radius of 0 or more")
        return Sphere(numbers[:3], float(numbers[3]))
    if "region" in volume:
        west, south, east, north, low, high = map(float, volume.numbers("region", 6))
        max_longitude, max_latitude = np.pi + 1e-9, np.pi / 2 + 1e-9
        if not (
            max(abs(west), abs(east)) <= max_longitude
            and -max_latitude <= south <= north <= max_latitude
            and low <= high
        ):
            volume.refuse("region", "west, south, east, north in radians, and two heights")
        return Region(west=west, south=south, east=east, north=north, minimum=low, maximum=high)
    volume.refuse("box", "a box, a sphere or a region")


def ecef(
    longitude: Float64[np.ndarray, " n"],
    latitude: Float64[np.ndarray, " n"],
    height: Float64[np.ndarray, " n"],
) -> Points:
    """Convert WGS 84 longitudes, latitudes (radians) and heights (metres) to ECEF points."""
    sine, cosine = np.sin(latitude), np.cos(latitude)
    axis_ratio_squared = (_POLE_RADIUS / _EQUATOR_RADIUS) ** 2
    radius = _EQUATOR_RADIUS / np.sqrt(cosine**2 + axis_ratio_squared * sine**2)
    ring = (radius + height) * cosine
    return np.column_stack(
        [
            ring * np.cos(longitude),
            ring * np.sin(longitude),
            (axis_ratio_squared * radius + height) * sine,
        ]
    )


def geodetic(
    points: Points,
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Convert ECEF points to longitudes, latitudes (radians) and heights (metres).

    B. R. Bowring 1976, "Transformation from spatial to geographical coordinates": three
    rounds are below a micrometre on the surface.
    """
    x, y, z = points.T
    ring = np.hypot(x, y)
    flat = _POLE_RADIUS / _EQUATOR_RADIUS
    reduced_latitude = np.arctan2(z, ring * flat)
    eccentricity_squared = 1 - flat**2
    second = _EQUATOR_RADIUS**2 / _POLE_RADIUS**2 - 1
    latitude = reduced_latitude
    for _ in range(3):
        latitude = np.arctan2(
            z + second * _POLE_RADIUS * np.sin(reduced_latitude) ** 3,
            ring - eccentricity_squared * _EQUATOR_RADIUS * np.cos(reduced_latitude) ** 3,
        )
        reduced_latitude = np.arctan2(flat * np.sin(latitude), np.cos(latitude))
    radius = _EQUATOR_RADIUS / np.sqrt(1 - eccentricity_squared * np.sin(latitude) ** 2)
    height = ring * np.cos(latitude) + z * np.sin(latitude) - _EQUATOR_RADIUS**2 / radius
    return np.arctan2(y, x), latitude, height


def _unit_axes(
    half_axes: Float64[np.ndarray, "3 3"], lengths: Float64[np.ndarray, " 3"]
) -> Float64[np.ndarray, "3 3"]:
    """Return the unit axes of a box; an axis of length zero becomes orthogonal to the others."""
    unit_axes = half_axes / np.where(lengths > 0, lengths, 1)[:, None]
    flat = [axis for axis in range(3) if lengths[axis] == 0]
    if len(flat) == 1:
        first, second = (unit_axes[(flat[0] + step) % 3] for step in (1, 2))
        unit_axes[flat[0]] = np.cross(first, second)
    elif len(flat) == 2:
        unit_axes[flat] = np.linalg.svd(unit_axes)[2][1:]
    elif flat:
        unit_axes = np.eye(3)
    return np.asarray(unit_axes)

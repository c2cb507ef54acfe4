"""View frustums and the boxes that intersect them: p-vertex culling in one matrix product."""

__all__ = ["Frustum"]

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Bool, Float64

from gsgen.contract.spec.geometry import rotation_matrix

if TYPE_CHECKING:
    from gsgen.runtime.scene.camera import Camera

Planes = Float64[np.ndarray, "k 4"]


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frustum:
    """A view frustum in the tileset's root frame: the planes around what a camera sees.

    Attributes:
        planes: A point x is inside where n·x + d ≥ 0 for every row (n, d); unit normals. Four
            sides and z ≥ 0, around the cone of rays of a camera with a lens; a panorama has none,
            nor has a fisheye that sees farther than a quarter turn from its axis.
        eye: Centre of the camera.
        rotation: Root frame → camera; its rows are right, down and forward.
        focal: Pixels for each unit of size over distance; of an orthographic camera, pixels
            for each unit.
        flat: Whether the camera is orthographic, so that size does not depend on distance.
    """

    planes: Planes
    eye: Float64[np.ndarray, " 3"]
    rotation: Float64[np.ndarray, "3 3"]
    focal: float
    flat: bool = False

    @classmethod
    def from_camera(
        cls, camera: "Camera", placement: Float64[np.ndarray, "4 4"] | None = None
    ) -> "Frustum":
        """Return the view frustum of a scene's camera.

        Args:
            camera: Of any kind.
            placement: From the root frame to the world, a similarity; identity where absent.
        """
        view = camera.view if placement is None else camera.view @ placement
        scale = float(np.cbrt(np.linalg.det(view[:3, :3])))
        turn, shift = view[:3, :3] / scale, view[:3, 3] / scale
        eye, focal = -turn.T @ shift, camera.fy
        planes = np.zeros((0, 4))
        if camera.kind == "fisheye" or camera.distortion is not None:
            planes = _cone_planes(camera.half_angle(), turn, shift)
        elif camera.kind != "panorama":
            right, low = camera.width - camera.cx, camera.height - camera.cy
            offsets = np.array([camera.cx, right, camera.cy, low])
            sides = np.zeros((5, 3))
            sides[:4, :2] = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
            sides[:4, :2] *= [camera.fx, camera.fy]
            sides[4, 2] = 1
            distances = np.zeros(5)
            if camera.kind == "pinhole":
                sides[:4, 2] = offsets
            else:
                distances[:4] = offsets / scale
            planes = _frustum_planes(sides, distances, turn, shift)
        flat = camera.kind == "orthographic"
        return cls(
            planes=planes, eye=eye, rotation=turn, focal=focal * scale if flat else focal, flat=flat
        )

    def moved(
        self, position: Float64[np.ndarray, " 3"], quaternion: Float64[np.ndarray, " 4"]
    ) -> "Frustum":
        """Return the view frustum after the camera has moved to another pose.

        Args:
            position: Camera centre in the root frame.
            quaternion: Camera → root frame, (w, x, y, z), of any length.
        """
        turn = rotation_matrix(quaternion[None])[0].T
        distances = self.planes[:, 3] + self.planes[:, :3] @ self.eye
        normals = self.planes[:, :3] @ self.rotation.T @ turn
        planes = np.column_stack([normals, distances - normals @ position])
        return replace(self, planes=planes, eye=np.asarray(position, np.float64), rotation=turn)

    def intersects(
        self, center: Float64[np.ndarray, "n 3"], half_axes: Float64[np.ndarray, "n 3 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return the mask of the boxes that reach the inner side of all planes of a view frustum.

        The corner farthest along a plane's normal (the p-vertex) decides, so that no box that
        meets the frustum is left out; near an edge, a few that do not meet it stay in.

        Args:
            center: Middles of the boxes, in the root frame.
            half_axes: Vectors from the middle to the faces, as rows.
        """
        if not len(self.planes):
            return np.ones(len(center), bool)
        vectors = np.concatenate([center[:, None], half_axes], axis=1).reshape(-1, 3)
        products = (vectors @ self.planes[:, :3].T).reshape(len(center), 4, -1)
        reach = products[:, 0] + self.planes[:, 3] + np.abs(products[:, 1:]).sum(axis=1)
        return np.asarray((reach >= 0).all(axis=1))

    def distances(
        self, center: Float64[np.ndarray, "n 3"], half_axes: Float64[np.ndarray, "n 3 3"]
    ) -> Float64[np.ndarray, " n"]:
        """Return the distances from the camera to boxes; 0 if a box holds the camera."""
        lengths = np.sqrt(np.square(half_axes).sum(axis=2))
        unit_axes = half_axes / np.where(lengths > 0, lengths, 1)[:, :, None]
        offset = self.eye - center
        along = np.einsum("nij,nj->ni", unit_axes, offset)
        squared_distances = np.square(np.maximum(np.abs(along) - lengths, 0)).sum(axis=1)
        # A flat box has no direction along an axis of length 0: what remains of the offset.
        flat = (lengths == 0).any(axis=1)
        if flat.any():
            squared_remainder = np.square(offset).sum(axis=1) - np.square(along).sum(axis=1)
            squared_distances += np.where(flat, np.maximum(squared_remainder, 0), 0)
        return np.asarray(np.sqrt(squared_distances))

    def screen_space_error(
        self, error: Float64[np.ndarray, " n"], distance: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Return screen-space errors of tiles in pixels: geometric error × focal length / distance.

        A positive error is infinite at distance 0, within a box. Orthographic cameras ignore the
        distance.
        """
        if self.flat:
            return error * self.focal
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = error * self.focal / distance
        return np.where(error > 0, pixels, 0.0)


def _cone_planes(
    half_angle: float, turn: Float64[np.ndarray, "3 3"], shift: Float64[np.ndarray, " 3"]
) -> Planes:
    """Return the planes of a pyramid around a cone about the axis, of half an angle in radians."""
    if not half_angle < math.pi / 2:
        return np.zeros((0, 4))
    cos, sin = math.cos(half_angle), math.sin(half_angle)
    sides = np.array([[cos, 0, sin], [-cos, 0, sin], [0, cos, sin], [0, -cos, sin], [0, 0, 1]])
    return _frustum_planes(sides, np.zeros(5), turn, shift)


def _frustum_planes(
    sides: Float64[np.ndarray, "k 3"],
    distances: Float64[np.ndarray, " k"],
    turn: Float64[np.ndarray, "3 3"],
    shift: Float64[np.ndarray, " 3"],
) -> Planes:
    """Transform a frustum's planes from the camera's frame to the tileset's root frame."""
    lengths = np.linalg.norm(sides, axis=1)
    sides, distances = sides / lengths[:, None], distances / lengths
    return np.column_stack([sides @ turn, sides @ shift + distances])

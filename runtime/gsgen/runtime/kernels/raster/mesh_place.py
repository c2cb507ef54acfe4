"""Computes the uniforms of drawn meshes, and the rays through the pixels of the image."""

__all__ = ["MESH_UNIFORM", "TO_LINEAR", "TO_SRGB", "PlacedMesh", "mesh_rays", "mesh_uniform"]

from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Float32, Shaped

from gsgen.runtime.gpu.mesh_residency import MeshBuffers
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh

_UNIFORM_FIELDS: Final = {
    "linear": ("(3,4)f4", 0),
    "upright": ("(3,4)f4", 48),
    "eye": ("3f4", 96),
    "shaded": ("u4", 108),
    "eye_rest": ("3f4", 112),
    "conversion": ("u4", 124),
    "focal": ("2f4", 128),
    "center": ("2f4", 136),
    "size": ("2f4", 144),
    "near": ("f4", 152),
    "is_flat": ("u4", 156),
    "textured": ("u4", 160),
    "period": ("f4", 164),
}
MESH_UNIFORM: Final = np.dtype(
    {
        "names": list(_UNIFORM_FIELDS),
        "formats": [field_format for field_format, _ in _UNIFORM_FIELDS.values()],
        "offsets": [offset for _, offset in _UNIFORM_FIELDS.values()],
        "itemsize": 256,  # a multiple of this is an offset that every device can bind at
    }
)
"""The bytes of ``struct Place`` in mesh_place.wgsl."""

TO_LINEAR: Final = 1
TO_SRGB: Final = 2


@final
@dataclass(frozen=True, slots=True, eq=False)
class PlacedMesh:
    """A mesh with its GPU buffers, and the colour space of its scene."""

    mesh: Mesh
    buffers: MeshBuffers
    color_space: Literal["srgb", "linear"]


def mesh_uniform(placed: PlacedMesh, camera: Camera) -> Shaped[np.ndarray, ""]:
    """Return the uniform data of a mesh (WGSL struct ``Place``), computed in float64."""
    uniform = np.zeros((), MESH_UNIFORM)
    mesh, data = placed.mesh, placed.mesh.data
    matrix = mesh.vertices_to_world
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    eye = np.linalg.solve(linear, camera.eye - offset)
    to_camera = camera.view[:3, :3] @ linear
    uniform["linear"][:, :3] = to_camera.T  # WGSL matrices are columns
    uniform["upright"][:, :3] = np.linalg.inv(to_camera)  # … and this is a transpose already
    uniform["eye"] = eye
    uniform["eye_rest"] = eye - uniform["eye"].astype(np.float64)
    uniform["shaded"] = mesh.shading == "headlight"
    if data.color_space != placed.color_space:
        uniform["conversion"] = TO_LINEAR if placed.color_space == "linear" else TO_SRGB
    center, pixel_period = np.array([camera.cx, camera.cy]), camera.period
    if pixel_period:  # of the positions a full turn apart, the one nearest to the image
        center[0] -= pixel_period * np.round((camera.cx - camera.width / 2) / pixel_period)
    uniform["focal"], uniform["center"], uniform["period"] = (
        (camera.fx, camera.fy),
        center,
        pixel_period,
    )
    uniform["size"], uniform["near"] = (camera.width, camera.height), camera.near
    uniform["is_flat"] = camera.kind == "orthographic"
    uniform["textured"] = data.texture is not None
    return uniform


def mesh_rays(camera: Camera) -> Float32[np.ndarray, "n 2"]:
    """Return the horizontal ray direction of each pixel column, then the vertical one of each row.

    In a panorama a direction is the sine and the cosine of an angle; elsewhere a slope and 0.
    """
    column_tangents = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    row_tangents = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    angles = np.concatenate([column_tangents, row_tangents])
    if camera.kind != "panorama":
        return np.stack([angles, np.zeros_like(angles)], 1).astype(np.float32)
    return np.stack([np.sin(angles), np.cos(angles)], 1).astype(np.float32)

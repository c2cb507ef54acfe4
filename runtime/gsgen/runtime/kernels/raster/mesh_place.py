"""What all triangles of a mesh share in a frame, and the rays of its pixels."""

__all__ = [
    "PLACE",
    "TO_LINEAR",
    "TO_SRGB",
    "PlacedMesh",
    "mesh_rays",
    "mesh_uniform",
]

from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Float32, Shaped

from gsgen.runtime.gpu.mesh_residency import MeshBuffers
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh

_FIELDS: Final = {
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
PLACE: Final = np.dtype(
    {
        "names": list(_FIELDS),
        "formats": [form for form, _ in _FIELDS.values()],
        "offsets": [offset for _, offset in _FIELDS.values()],
        "itemsize": 256,  # a step that every device can bind at
    }
)
"""The bytes of ``struct Place`` in draw_meshes.wgsl."""

TO_LINEAR: Final = 1
TO_SRGB: Final = 2


@final
@dataclass(frozen=True, slots=True, eq=False)
class PlacedMesh:
    """A mesh of a scene, and where its arrays are on the GPU.

    Attributes:
        mesh: What is drawn.
        buffers: Of its data.
        color_space: Of the scene.
    """

    mesh: Mesh
    buffers: MeshBuffers
    color_space: Literal["srgb", "linear"]


def mesh_uniform(placed: PlacedMesh, camera: Camera) -> Shaped[np.ndarray, ""]:
    """Return what all triangles of a mesh share, worked out in float64."""
    made = np.zeros((), PLACE)
    mesh, data = placed.mesh, placed.mesh.data
    linear, offset = mesh.transform[:3, :3], mesh.transform[:3, 3]
    eye = np.linalg.solve(linear, camera.eye - offset)
    seen = camera.view[:3, :3] @ linear
    made["linear"][:, :3] = seen.T  # WGSL matrices are columns
    made["upright"][:, :3] = np.linalg.inv(seen)  # … and this is a transpose already
    made["eye"] = eye
    made["eye_rest"] = eye - made["eye"].astype(np.float64)
    made["shaded"] = mesh.shading == "headlight"
    if data.color_space != placed.color_space:
        made["conversion"] = TO_LINEAR if placed.color_space == "linear" else TO_SRGB
    center, period = np.array([camera.cx, camera.cy]), camera.period
    if period:  # of the places a whole turn apart, the one next to the image
        center[0] -= period * np.round((camera.cx - camera.width / 2) / period)
    made["focal"], made["center"], made["period"] = (camera.fx, camera.fy), center, period
    made["size"], made["near"] = (camera.width, camera.height), camera.near
    made["is_flat"] = camera.kind == "orthographic"
    made["textured"] = data.texture is not None
    return made


def mesh_rays(camera: Camera) -> Float32[np.ndarray, "n 2"]:
    """Return where the pixels of each column look, and then of each row, rounded once.

    In a panorama that is the sine and the cosine of an angle; elsewhere a slope, and nothing.
    """
    across = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    down = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    angles = np.concatenate([across, down])
    if camera.kind != "panorama":
        return np.stack([angles, np.zeros_like(angles)], 1).astype(np.float32)
    return np.stack([np.sin(angles), np.cos(angles)], 1).astype(np.float32)

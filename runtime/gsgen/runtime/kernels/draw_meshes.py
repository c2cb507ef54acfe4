"""Draw meshes: opaque triangles through the hardware's rasteriser, as a layer among the splats."""

__all__ = ["DrawMeshes", "MeshesStep", "PlacedMesh", "mesh_uniform", "seen_reference"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np
from jaxtyping import Float, Shaped, UInt32

from gsgen.runtime.camera import Camera
from gsgen.runtime.device import Device
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.frame import srgb_of_linear
from gsgen.runtime.kernels.blend_tiles import NOWHERE, Layers
from gsgen.runtime.kernels.kernel import Kernel, Step
from gsgen.runtime.kernels.shader import TILE, source
from gsgen.runtime.mesh import Mesh, MeshData
from gsgen.runtime.mesh_residency import MeshBuffers

AMBIENT: Final = 0.2
"""What a headlight leaves of a colour where the surface is seen from the side."""
_FIELDS: Final = {
    "linear": ("(3,4)f4", 0),
    "eye": ("3f4", 48),
    "shaded": ("u4", 60),
    "eye_rest": ("3f4", 64),
    "conversion": ("u4", 76),
    "focal": ("2f4", 80),
    "center": ("2f4", 88),
    "size": ("2f4", 96),
    "near": ("f4", 104),
    "is_flat": ("u4", 108),
    "textured": ("u4", 112),
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

_TO_LINEAR: Final = 1
_TO_SRGB: Final = 2
_PIXEL: Final = 16  # bytes, of four floats
_ROW: Final = (
    256 // _PIXEL
)  # pixels: what a row of a copied texture has to be a multiple of
_FLOATS: Final = "rgba32float"
DEPTHS: Final = "depth32float"
_KINDS: Final = ("pinhole", "orthographic")


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
    """Return what all triangles of a mesh share, worked out in float64.

    Raises:
        SceneInvalid: The camera is neither a pinhole nor orthographic.
    """
    if camera.kind not in _KINDS:
        raise SceneInvalid(
            f"is {camera.kind}: meshes are drawn for {' and '.join(_KINDS)} cameras alone",
            where="camera.kind",
            mend="Leave the meshes out, or take a pinhole camera.",
        )
    made = np.zeros((), PLACE)
    mesh, data = placed.mesh, placed.mesh.data
    linear, offset = mesh.transform[:3, :3], mesh.transform[:3, 3]
    eye = np.linalg.solve(linear, camera.eye - offset)
    made["linear"][:, :3] = (camera.view[:3, :3] @ linear).T  # WGSL matrices are columns
    made["eye"] = eye
    made["eye_rest"] = eye - made["eye"].astype(np.float64)
    made["shaded"] = mesh.shading == "headlight"
    if data.color_space != placed.color_space:
        made["conversion"] = _TO_LINEAR if placed.color_space == "linear" else _TO_SRGB
    made["focal"], made["center"] = (camera.fx, camera.fy), (camera.cx, camera.cy)
    made["size"], made["near"] = (camera.width, camera.height), camera.near
    made["is_flat"] = camera.kind == "orthographic"
    made["textured"] = data.texture is not None
    return made


@final
@dataclass(frozen=True, slots=True, eq=False)
class MeshesStep:
    """One drawing of all meshes.

    Attributes:
        pipeline: What draws.
        draws: For each mesh its bind group and how many corners it has.
        color: Texture of colours, and 1 where a mesh is; over the background.
        surface: Texture of normals and depths.
        depth: View of the texture of near / z, which the rasteriser compares.
        copies: Buffers that ``color`` and ``surface`` are copied to.
        row: Pixels of a row of the copies.
        size: Width and height, in pixels.
        layers: What makes layers of the copies.
    """

    pipeline: Any
    draws: tuple[tuple[Any, int], ...]
    color: Any
    surface: Any
    depth: Any
    copies: tuple[Any, Any]
    row: int
    size: tuple[int, int]
    layers: tuple[Step, ...]

    def encode(
        self,
        encoder: Any,
        background: Float[np.ndarray, "3"],
        stamps: dict[str, Any] | None = None,
    ) -> None:
        """Draw over ``background``; the copies are made where there are layers."""
        targets = [
            _cleared(self.color, (*background.tolist(), 0.0)),
            _cleared(self.surface, (0.0, 0.0, 0.0, 0.0)),
        ]
        depth = {
            "view": self.depth,
            "depth_clear_value": 0.0,
            "depth_load_op": "clear",
            "depth_store_op": "store",
        }
        drawing = encoder.begin_render_pass(
            label="meshes",
            color_attachments=targets,
            depth_stencil_attachment=depth,
            timestamp_writes=stamps,
        )
        drawing.set_pipeline(self.pipeline)
        for bind, corners in self.draws:
            drawing.set_bind_group(0, bind)
            drawing.draw(corners)
        drawing.end()
        if self.layers:
            for texture, copy in zip((self.color, self.surface), self.copies, strict=True):
                encoder.copy_texture_to_buffer(
                    {"texture": texture},
                    {"buffer": copy, "bytes_per_row": self.row * _PIXEL},
                    (*self.size, 1),
                )


def _cleared(texture: Any, value: tuple[float, ...]) -> dict[str, Any]:
    return {
        "view": texture.create_view(),
        "clear_value": value,
        "load_op": "clear",
        "store_op": "store",
    }


@final
class DrawMeshes:
    """``draw_meshes.wgsl``, and ``lay_meshes.wgsl`` for what comes of it.

    Args:
        device: Where it runs.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        raw = device.raw
        kinds = [{"buffer": {"type": "uniform"}}]
        kinds += [{"buffer": {"type": "read-only-storage"}} for _ in range(4)]
        kinds += [{"texture": {"sample_type": "float"}}]
        entries = [
            {"binding": at, "visibility": "VERTEX|FRAGMENT", **kind}
            for at, kind in enumerate(kinds)
        ]
        self._layout = raw.create_bind_group_layout(label="meshes", entries=entries)
        code = source("draw_meshes", AMBIENT=AMBIENT)
        module = raw.create_shader_module(label="draw_meshes", code=code)
        self._pipeline = raw.create_render_pipeline(
            label="meshes",
            layout=raw.create_pipeline_layout(bind_group_layouts=[self._layout]),
            vertex={"module": module, "entry_point": "corner_of", "buffers": []},
            primitive={"topology": "triangle-list", "cull_mode": "none"},
            depth_stencil={
                "format": DEPTHS,
                "depth_write_enabled": True,
                "depth_compare": "greater",
            },
            fragment={
                "module": module,
                "entry_point": "seen_at",
                "targets": [{"format": _FLOATS}, {"format": _FLOATS}],
            },
        )
        outputs = {"lay_colors": ("urrw", "w"), "lay_normals": ("urrw",)}
        self._lay = {
            entry: Kernel(device, "lay_meshes", entry, groups, NOWHERE=NOWHERE)
            for entry, groups in outputs.items()
        }

    def step(
        self,
        size: tuple[int, int],
        meshes: Sequence[PlacedMesh],
        slots: Any,
        layers: Layers | None,
    ) -> MeshesStep:
        """Return the drawing of meshes.

        Args:
            size: Width and height of the image, in pixels.
            meshes: What is drawn; nothing but their buffers is kept.
            slots: Uniform buffer with a :data:`PLACE` for each.
            layers: Where the layer goes, or None where nobody reads it.
        """
        usage = "RENDER_ATTACHMENT|COPY_SRC"
        color, surface, depth = (
            self._device.raw.create_texture(
                label=f"mesh {name}", size=(*size, 1), format=form, usage=usage
            )
            for name, form in (
                ("colors", _FLOATS),
                ("surfaces", _FLOATS),
                ("depths", DEPTHS),
            )
        )
        row = -(-size[0] // _ROW) * _ROW
        copies: tuple[Any, ...] = ()
        if layers is not None:
            copies = tuple(
                self._device.storage(f"{name} of meshes", _PIXEL * row * size[1])
                for name in ("colors", "surfaces")
            )
        return MeshesStep(
            self._pipeline,
            tuple(
                (self._bound(one.buffers, slots, slot), 3 * one.buffers.count)
                for slot, one in enumerate(meshes)
                if one.buffers.count
            ),
            color,
            surface,
            depth.create_view(),
            copies,
            row,
            size,
            () if layers is None else self._laid(size, row, copies, layers),
        )

    def _bound(self, one: MeshBuffers, slots: Any, slot: int) -> Any:
        buffers = [(slots, slot * PLACE.itemsize, PLACE.itemsize)]
        buffers += [
            (buffer, 0, buffer.size)
            for buffer in (one.vertices, one.faces, one.colors, one.uvs)
        ]
        resources: list[Any] = [
            {"buffer": buffer, "offset": offset, "size": length}
            for buffer, offset, length in buffers
        ]
        return self._device.raw.create_bind_group(
            label="mesh",
            layout=self._layout,
            entries=[
                {"binding": at, "resource": resource}
                for at, resource in enumerate([*resources, one.picture])
            ],
        )

    def _laid(
        self, size: tuple[int, int], row: int, copies: tuple[Any, ...], layers: Layers
    ) -> tuple[Step, ...]:
        """Return what makes the last layer of the copies."""
        shape = self._device.uniform("mesh layer", 16)
        first = (layers.count - 1) * size[0] * size[1]
        self._device.write(shape, np.array([*size, row, first], np.uint32))
        groups = (-(-size[0] // TILE), -(-size[1] // TILE), 1)
        kernel = self._lay["lay_colors"]
        binds = (
            kernel.bind(shape, *copies, layers.colors),
            kernel.bind(layers.depths, group=1),
        )
        made = [Step(kernel, binds, groups)]
        if layers.normals is not None:
            kernel = self._lay["lay_normals"]
            made.append(
                Step(kernel, (kernel.bind(shape, *copies, layers.normals),), groups)
            )
        return tuple(made)


def seen_reference(
    data: MeshData, place: Shaped[np.ndarray, ""]
) -> Float[np.ndarray, "h w 8"]:
    """What ``draw_meshes.wgsl`` must see of a mesh: colour and 1, normal, depth.

    The corners of triangles are not snapped to a grid, so edges may differ.

    Args:
        data: The triangles.
        place: What :func:`mesh_uniform` makes.
    """
    width, height = (int(side) for side in place["size"])
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1) + 0.5
    slope = (pixels - place["center"]) / place["focal"].astype(np.float64)
    flat = bool(place["is_flat"])
    ray = np.concatenate([slope * (not flat), np.ones((height, width, 1))], -1)
    linear = np.asarray(place["linear"], np.float64)[:, :3].T
    offset = data.vertices - np.float64(place["eye"]) - np.float64(place["eye_rest"])
    at = offset @ linear.T
    made = np.zeros((height, width, 8))
    made[..., 7] = NOWHERE
    for face in data.faces:
        a, b, c = at[face]
        across = np.cross(b - a, c - a)
        size = np.linalg.norm(across)
        if not size > 0:
            continue
        start = np.zeros((height, width, 3))
        start[..., :2] = slope * (1 if flat else a[2]) - a[:2]
        p, q = np.cross(ray, c - a), np.cross(start, b - a)
        with np.errstate(all="ignore"):
            facing = p @ (b - a)
            u, v = (start * p).sum(-1) / facing, (ray * q).sum(-1) / facing
            depth = a[2] + q @ (c - a) / facing
            inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > place["near"])
        nearer = inside & (depth < made[..., 7])
        weights = np.stack([1 - u[nearer] - v[nearer], u[nearer], v[nearer]], -1)
        toward = (ray[nearer] @ across) / size
        upright = across / size * np.where(toward > 0, -1, 1)[:, None]
        color = _color_reference(data, face, weights, int(place["conversion"]))
        if place["shaded"]:
            slant = np.abs(toward) / np.linalg.norm(ray[nearer], axis=-1)
            color = color * (AMBIENT + (1 - AMBIENT) * slant)[:, None]
        one = np.ones((len(color), 1))
        made[nearer] = np.concatenate([color, one, upright, depth[nearer][:, None]], -1)
    return made


def _color_reference(
    data: MeshData, face: UInt32[np.ndarray, "3"], weights: np.ndarray, conversion: int
) -> np.ndarray:
    color = weights @ data.colors[face].astype(np.float64)
    if data.texture is not None and data.uv is not None:
        size = np.array(data.texture.shape[1::-1])
        inside = weights @ data.uv[face].astype(np.float64) % 1
        place = np.stack([inside[:, 0], 1 - inside[:, 1]], -1) * size - 0.5
        low = np.floor(place).astype(int)
        sums = np.zeros_like(color)
        for step in ((0, 0), (1, 0), (0, 1), (1, 1)):
            share = np.prod(1 - np.abs(place - low - step), axis=-1)
            column, row = ((low + step) % size).T
            sums += share[:, None] * data.texture[row, column, :3] / 255
        color = color * sums
    if conversion == _TO_LINEAR:
        curved = ((color + 0.055) / 1.055) ** 2.4
        return np.asarray(np.where(color <= 0.04045, color / 12.92, curved))
    return srgb_of_linear(color) if conversion == _TO_SRGB else color

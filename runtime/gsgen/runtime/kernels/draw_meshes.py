"""Draw meshes: opaque triangles through the hardware's rasteriser, as a layer among the splats."""

__all__ = ["DrawMeshes", "MeshesStep", "seen_reference"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt32

from gsgen.runtime.device import Device
from gsgen.runtime.frame import srgb_of_linear
from gsgen.runtime.kernels.blend_tiles import NOWHERE, Layers
from gsgen.runtime.kernels.kernel import Kernel, Step
from gsgen.runtime.kernels.mesh_place import PLACE, TO_LINEAR, TO_SRGB, PlacedMesh
from gsgen.runtime.kernels.shader import TILE, source
from gsgen.runtime.mesh import MeshData
from gsgen.runtime.mesh_residency import MeshBuffers

AMBIENT: Final = 0.2
"""What a headlight leaves of a colour where the surface is seen from the side."""
_PIXEL: Final = 16  # bytes, of four floats
_ROW: Final = (
    256 // _PIXEL
)  # pixels: what a row of a copied texture has to be a multiple of
_FLOATS: Final = "rgba32float"
DEPTHS: Final = "depth32float"


@final
@dataclass(frozen=True, slots=True, eq=False)
class MeshesStep:
    """One drawing of all meshes.

    Attributes:
        pipeline: What draws.
        draws: For each mesh its bind group, and how many corners and instances are drawn.
        color: Texture of colours, and 1 where a mesh is; over the background.
        surface: Texture of normals and depths.
        depth: View of the texture of near / z, which the rasteriser compares.
        copies: Buffers that ``color`` and ``surface`` are copied to.
        row: Pixels of a row of the copies.
        size: Width and height, in pixels.
        layers: What makes layers of the copies.
    """

    pipeline: Any
    draws: tuple[tuple[Any, int, int], ...]
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
        for bind, corners, instances in self.draws:
            drawing.set_bind_group(0, bind)
            drawing.draw(corners, instances)
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
        panorama: Whether the image is one: a triangle then has a box of four corners.
    """

    def __init__(self, device: Device, panorama: bool = False) -> None:
        self._device, self._panorama = device, panorama
        raw = device.raw
        kinds = [{"buffer": {"type": "uniform"}}]
        kinds += [{"buffer": {"type": "read-only-storage"}} for _ in range(5)]
        kinds += [{"texture": {"sample_type": "float"}}]
        entries = [
            {"binding": at, "visibility": "VERTEX|FRAGMENT", **kind}
            for at, kind in enumerate(kinds)
        ]
        self._layout = raw.create_bind_group_layout(label="meshes", entries=entries)
        code = source("draw_meshes", AMBIENT=AMBIENT, PANORAMA=panorama)
        module = raw.create_shader_module(label="draw_meshes", code=code)
        entry = "corner_around" if panorama else "corner_of"
        topology = "triangle-strip" if panorama else "triangle-list"
        self._pipeline = raw.create_render_pipeline(
            label="meshes",
            layout=raw.create_pipeline_layout(bind_group_layouts=[self._layout]),
            vertex={"module": module, "entry_point": entry, "buffers": []},
            primitive={"topology": topology, "cull_mode": "none"},
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
        rays: Any,
        layers: Layers | None,
    ) -> MeshesStep:
        """Return the drawing of meshes.

        Args:
            size: Width and height of the image, in pixels.
            meshes: What is drawn; nothing but their buffers is kept.
            slots: Uniform buffer with a :data:`PLACE` for each.
            rays: Buffer of what :func:`mesh_rays` makes.
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
                (self._bound(one.buffers, slots, slot, rays), *self._corners(one.buffers))
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

    def _corners(self, one: MeshBuffers) -> tuple[int, int]:
        """Return how many corners are drawn, and how often."""
        return (4, one.count) if self._panorama else (3 * one.count, 1)

    def _bound(self, one: MeshBuffers, slots: Any, slot: int, rays: Any) -> Any:
        buffers = [(slots, slot * PLACE.itemsize, PLACE.itemsize)]
        buffers += [
            (buffer, 0, buffer.size)
            for buffer in (rays, one.vertices, one.faces, one.colors, one.uvs)
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
    data: MeshData, place: Shaped[np.ndarray, ""], rays: Float32[np.ndarray, "n 2"]
) -> Float[np.ndarray, "h w 8"]:
    """What ``draw_meshes.wgsl`` must see of a mesh: colour and 1, normal, depth.

    The corners of triangles are not snapped to a grid, so edges may differ.

    Args:
        data: The triangles.
        place: What :func:`mesh_uniform` makes.
        rays: What :func:`mesh_rays` makes.
    """
    width, height = (int(side) for side in place["size"])
    across, down = np.float64(rays[:width]), np.float64(rays[width:, None])
    ray = _direction_reference(across, down, place)
    linear = np.asarray(place["linear"], np.float64)[:, :3].T
    offset = data.vertices - np.float64(place["eye"]) - np.float64(place["eye_rest"])
    at = offset @ linear.T
    made = np.zeros((height, width, 8))
    made[..., 7] = NOWHERE
    for face in data.faces:
        upright = np.cross(at[face[1]] - at[face[0]], at[face[2]] - at[face[0]])
        size = np.linalg.norm(upright)
        if not size > 0:
            continue
        beside = [_beside_reference(corner, across, down, place) for corner in at[face]]
        areas = np.stack(
            [
                beside[i][0] * beside[j][1] - beside[i][1] * beside[j][0]
                for i, j in ((1, 2), (2, 0), (0, 1))
            ],
            -1,
        )
        with np.errstate(all="ignore"):
            weights = areas / areas.sum(axis=-1, keepdims=True)
            depth = sum(weights[..., i] * beside[i][2] for i in range(3))
            inside = (weights >= 0).all(axis=-1) & (depth > place["near"])
        nearer = inside & (depth < made[..., 7])
        toward = ray[nearer] @ upright / size
        facing = upright / size * np.where(toward > 0, -1, 1)[:, None]
        color = _color_reference(data, face, weights[nearer], int(place["conversion"]))
        if place["shaded"]:
            slant = np.abs(toward) / np.linalg.norm(ray[nearer], axis=-1)
            color = color * (AMBIENT + (1 - AMBIENT) * slant)[:, None]
        one = np.ones((len(color), 1))
        made[nearer] = np.concatenate([color, one, facing, depth[nearer][:, None]], -1)
    return made


def _beside_reference(
    at: Float[np.ndarray, "3"],
    across: Float[np.ndarray, "w 2"],
    down: Float[np.ndarray, "h 1 2"],
    place: Shaped[np.ndarray, ""],
) -> tuple[Float[np.ndarray, "h w"], ...]:
    """Return how far a point is to the right of each pixel's ray, how far below, and its depth."""
    x, y, z = at
    if not place["period"]:
        scale = 1 if place["is_flat"] else z
        right, below = x - across[:, 0] * scale, y - down[..., 0] * scale
        depth = np.broadcast_to(z, (len(down), len(across)))
        return (
            np.broadcast_to(right, depth.shape),
            np.broadcast_to(below, depth.shape),
            depth,
        )
    level = across[:, 0] * x + across[:, 1] * z
    right = np.broadcast_to(across[:, 1] * x - across[:, 0] * z, (len(down), len(across)))
    sine, cosine = down[..., 0], down[..., 1]
    return right, cosine * y - sine * level, sine * y + cosine * level


def _direction_reference(
    across: Float[np.ndarray, "w 2"],
    down: Float[np.ndarray, "h 1 2"],
    place: Shaped[np.ndarray, ""],
) -> Float[np.ndarray, "h w 3"]:
    shape = len(down), len(across)
    (x, z), (y, level) = across.T, (down[..., 0], down[..., 1])
    made = [x * level, np.broadcast_to(y, shape), z * level]
    if not place["period"]:
        slope = 0 if place["is_flat"] else 1
        made = [np.broadcast_to(slope * x, shape), np.broadcast_to(slope * y, shape)]
        made.append(np.ones(shape))
    return np.stack(made, -1)


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
    if conversion == TO_LINEAR:
        curved = ((color + 0.055) / 1.055) ** 2.4
        return np.asarray(np.where(color <= 0.04045, color / 12.92, curved))
    return srgb_of_linear(color) if conversion == TO_SRGB else color

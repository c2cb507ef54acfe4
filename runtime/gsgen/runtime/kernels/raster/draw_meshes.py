"""Draw meshes: opaque triangles through the hardware's rasteriser, as a layer among the splats."""

__all__ = ["DrawMeshes", "MeshesStep", "seen_reference"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt32

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.mesh_residency import MeshBuffers
from gsgen.runtime.kernels.raster.mesh_place import PLACE, TO_LINEAR, TO_SRGB, PlacedMesh
from gsgen.runtime.kernels.shared.kernel import Kernel, Step
from gsgen.runtime.kernels.shared.shader import NOWHERE, TILE, source
from gsgen.runtime.kernels.tiles.blend_tiles import Layers
from gsgen.runtime.scene.frame import srgb_of_linear
from gsgen.runtime.scene.mesh import MeshData

AMBIENT: Final = 0.2
"""What a headlight leaves of a colour where the surface is seen from the side."""
_CORNERS: Final = 3
_CORNERS_AROUND: Final = 6  # of a box that has a triangle of a panorama
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
        draws: For each mesh its bind group and how many triangles it has.
        corners: How many are drawn for a triangle.
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
    corners: int
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
        for bind, triangles in self.draws:
            drawing.set_bind_group(0, bind)
            drawing.draw(self.corners * triangles)
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


def _pipeline(device: Device, **parts: Any) -> Any:
    """Return a render pipeline; nothing but asking for one tells whether floats can be drawn."""
    import wgpu

    try:
        return device.raw.create_render_pipeline(**parts)
    except wgpu.GPUValidationError as error:
        if "not renderable" not in str(error):
            raise
        raise DeviceUnavailable(
            f"{device.name} cannot draw meshes: not into textures of 32-bit floats",
            hint="Draw on another device, see `gsgen doctor`, or without meshes.",
        ) from error


@final
class DrawMeshes:
    """``draw_meshes.wgsl``, and ``lay_meshes.wgsl`` for what comes of it.

    Args:
        device: Where it runs.
        panorama: Whether the image is one.

    Raises:
        DeviceUnavailable: It cannot draw into textures of 32-bit floats.
    """

    def __init__(self, device: Device, panorama: bool = False) -> None:
        self._device = device
        raw = device.raw
        kinds = [{"buffer": {"type": "uniform"}}]
        kinds += [{"buffer": {"type": "read-only-storage"}} for _ in range(5)]
        kinds += [{"texture": {"sample_type": "float"}}]
        entries = [
            {"binding": at, "visibility": "VERTEX|FRAGMENT", **kind}
            for at, kind in enumerate(kinds)
        ]
        self._layout = raw.create_bind_group_layout(label="meshes", entries=entries)
        self._corners = _CORNERS_AROUND if panorama else _CORNERS
        code = source(
            "draw_meshes", AMBIENT=AMBIENT, PANORAMA=panorama, CORNERS=self._corners
        )
        module = raw.create_shader_module(label="draw_meshes", code=code)
        self._pipeline = _pipeline(
            device,
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
            entry: Kernel(device, "lay_meshes", entry, groups)
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
                (self._bound(one.buffers, slots, slot, rays), one.buffers.count)
                for slot, one in enumerate(meshes)
                if one.buffers.count
            ),
            self._corners,
            color,
            surface,
            depth.create_view(),
            copies,
            row,
            size,
            () if layers is None else self._laid(size, row, copies, layers),
        )

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

    Args:
        data: The triangles.
        place: What :func:`mesh_uniform` makes.
        rays: What :func:`mesh_rays` makes.
    """
    width, height = (int(side) for side in place["size"])
    ray = _direction_reference(place, rays)
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
        beside = np.stack([_beside_reference(one, place, rays) for one in at[face]])
        x, y, z = np.moveaxis(beside, -1, 0)
        after, last = [1, 2, 0], [2, 0, 1]
        areas = x[after] * y[last] - y[after] * x[last]
        with np.errstate(all="ignore"):
            weights = np.moveaxis(areas / areas.sum(axis=0), 0, -1)
            depth = (weights * np.moveaxis(z, 0, -1)).sum(axis=-1)
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
    place: Shaped[np.ndarray, ""],
    rays: Float32[np.ndarray, "n 2"],
) -> Float[np.ndarray, "h w 3"]:
    """Return how far a point is to the right of each pixel's ray, how far below, and its depth."""
    (sine, cosine), (down_sine, down_cosine) = _angles(place, rays)
    x, y, z = at
    if place["period"]:
        level = sine * x + cosine * z
        right, below = cosine * x - sine * z, down_cosine * y - down_sine * level
        made = np.broadcast_arrays(right, below, down_sine * y + down_cosine * level)
    else:
        scale = 1 if place["is_flat"] else z
        made = np.broadcast_arrays(x - sine * scale, y - down_sine * scale, z)
    return np.stack(made, -1)


def _direction_reference(
    place: Shaped[np.ndarray, ""], rays: Float32[np.ndarray, "n 2"]
) -> Float[np.ndarray, "h w 3"]:
    """Return the direction of each pixel's ray, along which depths are counted."""
    (x, z), (y, level) = _angles(place, rays)
    if place["period"]:
        return np.stack(np.broadcast_arrays(x * level, y, z * level), -1)
    slope = 0 if place["is_flat"] else 1
    return np.stack(np.broadcast_arrays(slope * x, slope * y, 1.0), -1)


def _angles(
    place: Shaped[np.ndarray, ""], rays: Float32[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "2 1 w"], Float[np.ndarray, "2 h 1"]]:
    """Return the two numbers that columns have, and those that rows have."""
    width, wide = int(place["size"][0]), rays.T.astype(np.float64)
    return wide[:, None, :width], wide[:, width:, None]


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

"""Draws opaque meshes with the hardware's rasteriser, as a layer among the splats."""

__all__ = ["DrawMeshes", "MeshesStep"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import (
    BindGroup,
    Buffer,
    Encoder,
    PassTimestamps,
    RenderPipeline,
    Texture,
    TextureView,
)
from gsgen.runtime.gpu.mesh_residency import MeshBuffers
from gsgen.runtime.kernels.raster.mesh_place import MESH_UNIFORM, PlacedMesh
from gsgen.runtime.kernels.raster.render_pipeline import render_pipeline
from gsgen.runtime.kernels.shared.kernel import VEC4, Kernel, Step
from gsgen.runtime.kernels.shared.shader import TILE, source
from gsgen.runtime.kernels.tiles.blend_tiles import Layers

AMBIENT_LIGHT: Final = 0.2
"""The share of a headlit colour on surfaces seen edge-on."""
_TRIANGLE_CORNERS: Final = 3
_PANORAMA_CORNERS: Final = 6  # of the two triangles that bound a triangle in a panorama
_ROW_ALIGNMENT: Final = 256 // VEC4  # pixels: rows of a copied texture are multiples of this
_FLOAT_FORMAT: Final = "rgba32float"
DEPTH_FORMAT: Final = "depth32float"


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeshesStep:
    """A recorded render pass that draws all meshes of a frame with the rasterisation hardware.

    Attributes:
        pipeline: The render pipeline.
        draw_calls: The bind group and the number of triangles of each mesh.
        corners: Vertices that are drawn per triangle.
        color: Texture of colours over the background; alpha is 1 where a mesh is visible.
        surface: Texture of normals and depths.
        depth: View of the depth texture, which holds near / z.
        copies: Buffers that ``color`` and ``surface`` are copied to.
        row: Pixels of a row of the copies.
        size: Width and height, in pixels.
        layers: Steps that convert the copies to a layer.
    """

    pipeline: RenderPipeline
    draw_calls: tuple[tuple[BindGroup, int], ...]
    corners: int
    color: Texture
    surface: Texture
    depth: TextureView
    copies: tuple[Buffer, ...]
    row: int
    size: tuple[int, int]
    layers: tuple[Step, ...]

    def encode(
        self,
        encoder: Encoder,
        background: Float[np.ndarray, "3"],
        pass_timestamps: PassTimestamps | None = None,
    ) -> None:
        """Encode drawing meshes over ``background``, and copying the result to an image layer."""
        targets = [
            _clear_attachment(self.color, (*background.tolist(), 0.0)),
            _clear_attachment(self.surface, (0.0, 0.0, 0.0, 0.0)),
        ]
        depth = {
            "view": self.depth,
            "depth_clear_value": 0.0,
            "depth_load_op": "clear",
            "depth_store_op": "store",
        }
        render_pass = encoder.begin_render_pass(
            label="meshes",
            color_attachments=targets,
            depth_stencil_attachment=depth,
            timestamp_writes=pass_timestamps,
        )
        render_pass.set_pipeline(self.pipeline)
        for bind, triangles in self.draw_calls:
            render_pass.set_bind_group(0, bind)
            render_pass.draw(self.corners * triangles)
        render_pass.end()
        if self.layers:
            for texture, copy in zip((self.color, self.surface), self.copies, strict=True):
                encoder.copy_texture_to_buffer(
                    {"texture": texture},
                    {"buffer": copy, "bytes_per_row": self.row * VEC4},
                    (*self.size, 1),
                )


def _clear_attachment(texture: Texture, value: tuple[float, ...]) -> dict[str, object]:
    return {
        "view": texture.create_view(),
        "clear_value": value,
        "load_op": "clear",
        "store_op": "store",
    }


@final
class DrawMeshes:
    """Draws meshes (``draw_meshes.wgsl``) and copies them to an image layer (``lay_meshes.wgsl``).

    Raises:
        DeviceUnavailable: The device cannot render to textures of 32-bit floats.
    """

    def __init__(self, device: Device, *, panorama: bool = False) -> None:
        import wgpu

        self._device = device
        self._corner_count = _PANORAMA_CORNERS if panorama else _TRIANGLE_CORNERS
        kinds: list[dict[str, object]] = [{"buffer": {"type": "uniform"}}]
        kinds += [{"buffer": {"type": "read-only-storage"}} for _ in range(5)]
        kinds += [{"texture": {"sample_type": "float"}}]
        try:
            self._pipeline, self._layout = render_pipeline(
                device,
                "meshes",
                source(
                    "draw_meshes",
                    AMBIENT=AMBIENT_LIGHT,
                    PANORAMA=panorama,
                    CORNERS=self._corner_count,
                ),
                kinds,
                fragment="seen_at",
                targets=[{"format": _FLOAT_FORMAT}, {"format": _FLOAT_FORMAT}],
                depth_stencil={
                    "format": DEPTH_FORMAT,
                    "depth_write_enabled": True,
                    "depth_compare": "greater",
                },
            )
        except wgpu.GPUValidationError as error:
            if "not renderable" not in str(error):
                raise
            raise DeviceUnavailable(
                f"{device.name} cannot render to textures of 32-bit floats, which meshes need",
                hint="Draw on another device, see `gsgen doctor`, or without meshes.",
            ) from error
        outputs = {"lay_colors": ("urrw", "w"), "lay_normals": ("urrw",)}
        self._layer_kernels = {
            entry: Kernel(device, "lay_meshes", entry, groups) for entry, groups in outputs.items()
        }

    def step(
        self,
        size: tuple[int, int],
        meshes: Sequence[PlacedMesh],
        slots: Buffer,
        rays: Buffer,
        layers: Layers | None,
    ) -> MeshesStep:
        """Record a render pass that draws meshes.

        Args:
            size: Width and height of the image, in pixels.
            meshes: The meshes; only their buffers are kept.
            slots: Uniform buffer with a :data:`MESH_UNIFORM` for each mesh.
            rays: Buffer with the result of :func:`mesh_rays`.
            layers: Layers whose last receives the meshes, or None.
        """
        usage = "RENDER_ATTACHMENT|COPY_SRC"
        color, surface, depth = (
            self._device.raw.create_texture(
                label=f"mesh {name}", size=(*size, 1), format=texture_format, usage=usage
            )
            for name, texture_format in (
                ("colors", _FLOAT_FORMAT),
                ("surfaces", _FLOAT_FORMAT),
                ("depths", DEPTH_FORMAT),
            )
        )
        row = -(-size[0] // _ROW_ALIGNMENT) * _ROW_ALIGNMENT
        copies: tuple[Buffer, ...] = ()
        if layers is not None:
            copies = tuple(
                self._device.storage(f"{name} of meshes", VEC4 * row * size[1])
                for name in ("colors", "surfaces")
            )
        return MeshesStep(
            pipeline=self._pipeline,
            draw_calls=tuple(
                (self._bind_mesh(mesh.buffers, slots, slot, rays), mesh.buffers.count)
                for slot, mesh in enumerate(meshes)
                if mesh.buffers.count
            ),
            corners=self._corner_count,
            color=color,
            surface=surface,
            depth=depth.create_view(),
            copies=copies,
            row=row,
            size=size,
            layers=() if layers is None else self._layer_steps(size, row, copies, layers),
        )

    def _bind_mesh(self, mesh: MeshBuffers, slots: Buffer, slot: int, rays: Buffer) -> BindGroup:
        buffers = [(slots, slot * MESH_UNIFORM.itemsize, MESH_UNIFORM.itemsize)]
        buffers += [
            (buffer, 0, buffer.size)
            for buffer in (rays, mesh.vertices, mesh.faces, mesh.colors, mesh.uvs)
        ]
        resources: list[object] = [
            {"buffer": buffer, "offset": offset, "size": length}
            for buffer, offset, length in buffers
        ]
        return self._device.raw.create_bind_group(
            label="mesh",
            layout=self._layout,
            entries=[
                {"binding": binding, "resource": resource}
                for binding, resource in enumerate([*resources, mesh.picture])
            ],
        )

    def _layer_steps(
        self, size: tuple[int, int], row: int, copies: tuple[Buffer, ...], layers: Layers
    ) -> tuple[Step, ...]:
        """Return the dispatches that copy the colours, depths and normals of meshes to a layer."""
        shape = self._device.uniform("mesh layer", 16)
        first = (layers.count - 1) * size[0] * size[1]
        self._device.write(shape, np.array([*size, row, first], np.uint32))
        groups = (-(-size[0] // TILE), -(-size[1] // TILE), 1)
        kernel = self._layer_kernels["lay_colors"]
        bind_groups = (
            kernel.bind(shape, *copies, layers.colors),
            kernel.bind(layers.depths, group=1),
        )
        steps = [Step(kernel, bind_groups, groups)]
        if layers.normals is not None:
            kernel = self._layer_kernels["lay_normals"]
            steps.append(Step(kernel, (kernel.bind(shape, *copies, layers.normals),), groups))
        return tuple(steps)

"""Draws splats as quads with the rasterisation hardware instead of by image tiles."""

__all__ = ["DrawQuads", "QuadsStep"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float

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
from gsgen.runtime.kernels.raster.draw_meshes import DEPTH_FORMAT, MeshesStep
from gsgen.runtime.kernels.raster.render_pipeline import render_pipeline
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS, Counts
from gsgen.runtime.kernels.shared.shader import source

_ROW_BYTES: Final = 256  # rows of a copied texture are multiples of this
_BLEND_UNDER: Final = {"src_factor": "one", "dst_factor": "one-minus-src-alpha", "operation": "add"}
_DEPTH_TEST: Final = {
    "format": DEPTH_FORMAT,
    "depth_write_enabled": False,
    "depth_compare": "greater-equal",
}


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuadsStep:
    """A recorded render pass that draws all splats of a frame as quads.

    Attributes:
        pipeline: The render pipeline.
        bind: The bind group of the pipeline.
        texture: The render target; that of the meshes if there are any.
        view: View of the texture.
        counts: Buffer with the arguments of the indirect draw.
        image: The buffer that the texture is copied to.
        row_bytes: Bytes of a row of the image.
        size: Width and height, in pixels.
        depth: View of the meshes' depths; None without meshes.
    """

    pipeline: RenderPipeline
    bind: BindGroup
    texture: Texture
    view: TextureView
    counts: Buffer
    image: Buffer
    row_bytes: int
    size: tuple[int, int]
    depth: TextureView | None

    def encode(
        self,
        encoder: Encoder,
        background: Float[np.ndarray, "3"],
        pass_timestamps: PassTimestamps | None = None,
    ) -> None:
        """Encode a render pass of quads over ``background`` or meshes, and a copy of its image."""
        target = {
            "view": self.view,
            "clear_value": (*background.tolist(), 0.0),
            "load_op": "clear" if self.depth is None else "load",
            "store_op": "store",
        }
        has_depth_test = (
            None if self.depth is None else {"view": self.depth, "depth_read_only": True}
        )
        render_pass = encoder.begin_render_pass(
            label="quads",
            color_attachments=[target],
            depth_stencil_attachment=has_depth_test,
            timestamp_writes=pass_timestamps,
        )
        render_pass.set_pipeline(self.pipeline)
        render_pass.set_bind_group(0, self.bind)
        render_pass.draw_indirect(self.counts, 4 * Counts.DRAW_ARGUMENTS)
        render_pass.end()
        encoder.copy_texture_to_buffer(
            {"texture": self.texture},
            {"buffer": self.image, "bytes_per_row": self.row_bytes},
            (*self.size, 1),
        )


@final
class DrawQuads:
    """The render pipeline of ``draw_quads.wgsl``, which draws splats as quads.

    Args:
        device: A device that can blend 32-bit floats.
        has_depth_test: Whether meshes may hide splats.
        panorama: Whether the image is a panorama.
        records: Whether each splat is one record.
    """

    def __init__(
        self,
        device: Device,
        *,
        has_depth_test: bool = False,
        panorama: bool = False,
        records: bool = False,
    ) -> None:
        self._device = device
        code = source(
            "draw_quads",
            TESTED=has_depth_test,
            RECORDS=records,
            PANORAMA=panorama,
            **COUNT_CONSTANTS,
        )
        kinds = ["uniform"] + ["read-only-storage"] * 5
        self._pipeline, self._layout = render_pipeline(
            device,
            "quads",
            code,
            [{"buffer": {"type": kind}} for kind in kinds],
            topology="triangle-strip",
            targets=[
                {"format": "rgba32float", "blend": {"color": _BLEND_UNDER, "alpha": _BLEND_UNDER}}
            ],
            depth_stencil=_DEPTH_TEST if has_depth_test else None,
        )

    @staticmethod
    def row_bytes(width: int) -> int:
        """Return the bytes of a row of an image buffer, padded as texture copies require."""
        return -(-16 * width // _ROW_BYTES) * _ROW_BYTES

    def step(
        self,
        size: tuple[int, int],
        resources: tuple[Buffer, ...],
        counts: Buffer,
        image: Buffer,
        meshes: MeshesStep | None = None,
    ) -> QuadsStep:
        """Record a render pass that draws all splats.

        Args:
            size: Width and height, in pixels.
            resources: Resources of ``draw_quads.wgsl``, in order.
            counts: The frame's counts.
            image: A buffer with rows of :meth:`row_bytes`.
            meshes: Drawing of the meshes that hide splats, or None.
        """
        texture = meshes.color if meshes else self._create_texture(size)
        bind = self._device.raw.create_bind_group(
            label="quads",
            layout=self._layout,
            entries=[
                {
                    "binding": binding,
                    "resource": {"buffer": resource, "offset": 0, "size": resource.size},
                }
                for binding, resource in enumerate(resources)
            ],
        )
        return QuadsStep(
            pipeline=self._pipeline,
            bind=bind,
            texture=texture,
            view=texture.create_view(),
            counts=counts,
            image=image,
            row_bytes=self.row_bytes(size[0]),
            size=size,
            depth=meshes.depth if meshes else None,
        )

    def _create_texture(self, size: tuple[int, int]) -> Texture:
        return self._device.texture(
            "image of quads", size, "rgba32float", "RENDER_ATTACHMENT|COPY_SRC"
        )

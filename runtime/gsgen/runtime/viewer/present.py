"""Shows a drawn image, and panels over it, on the surface of a window."""

__all__ = ["PRESENT_CONSTANTS", "PRESENT_UNIFORM", "Panel", "PresentPass", "View"]

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
from jaxtyping import UInt8

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import (
    BindGroup,
    BindGroupLayout,
    Buffer,
    RawDevice,
    RenderPass,
    Texture,
)
from gsgen.runtime.kernels.raster.render_pipeline import render_pipeline
from gsgen.runtime.kernels.shared.shader import source
from gsgen.runtime.media.pictures import PICTURE_MODES, Mode
from gsgen.runtime.renderer.bands import DrawnImage
from gsgen.runtime.scene.camera import Camera

_NUMBER_BY_MODE: Final[dict[Mode, int]] = {
    mode: number for number, mode in enumerate(PICTURE_MODES)
}
PRESENT_CONSTANTS: Final = {
    "MODE_DEPTH": _NUMBER_BY_MODE["depth"],
    "MODE_MEDIAN": _NUMBER_BY_MODE["median-depth"],
    "MODE_NORMAL": _NUMBER_BY_MODE["normal"],
    "MODE_ALPHA": _NUMBER_BY_MODE["alpha"],
}
"""The modes of present.wgsl; other numbers show colours."""

PRESENT_UNIFORM: Final = np.dtype(
    [
        ("turn", np.float32, (3, 4)),
        ("size", np.float32, 2),
        ("scale", np.float32, 2),
        ("row", np.uint32),
        ("mode", np.uint32),
        ("near", np.float32),
        ("far", np.float32),
        ("is_linear", np.uint32),
        ("first", np.uint32),
        ("background_alpha", np.float32),
        ("filling", np.uint32),
    ]
)
"""The bytes of ``struct Showing`` in present.wgsl."""

_UNIFORM_BINDING: Final = {"buffer": {"type": "uniform"}}
_BLEND_OVER: Final = {"src_factor": "one", "dst_factor": "one-minus-src-alpha", "operation": "add"}


@final
@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A small sRGB image, multiplied by alpha, that is drawn over the surface at a corner."""

    picture: UInt8[np.ndarray, "h w 4"]
    corner: tuple[int, int]


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class View:
    """A drawn image in GPU memory, with the settings of showing it on a window's surface.

    Its bands follow each other from the top to the bottom.
    """

    bands: Sequence[DrawnImage]
    camera: Camera
    mode: Mode
    depths: tuple[float, float] = (0.0, 1.0)
    color_space: Literal["srgb", "linear"] = "srgb"


@final
class PresentPass:
    """Draws an image and panels on a surface, by ``present.wgsl`` and ``panel.wgsl``.

    Args:
        device: The device of the images.
        format: Texture format of the surface, without an sRGB curve of its own.
    """

    def __init__(self, device: Device, format: str) -> None:
        self._device = device
        self._pipeline, self._layout = render_pipeline(
            device,
            "present",
            source("present", **PRESENT_CONSTANTS),
            [_UNIFORM_BINDING, {"buffer": {"type": "read-only-storage"}}],
            targets=[{"format": format}],
        )
        blend_state = {"color": _BLEND_OVER, "alpha": _BLEND_OVER}
        self._panels, self._panel_layout = render_pipeline(
            device,
            "panel",
            source("panel"),
            [_UNIFORM_BINDING, {"texture": {"sample_type": "float"}}],
            targets=[{"format": format, "blend": blend_state}],
        )
        self._bindings: dict[Buffer, tuple[Buffer, BindGroup]] = {}
        self._panel_bindings: dict[Panel, tuple[Texture, BindGroup]] = {}

    def __call__(self, target: Texture, view: View | None, panels: Sequence[Panel]) -> None:
        """Draw an image (black if None) on a window's surface, then the panels in order over it."""
        width, height = target.size[:2]
        encoder = self._device.raw.create_command_encoder(label="present")
        attachment = {
            "view": target.create_view(),
            "clear_value": (0.0, 0.0, 0.0, 1.0),
            "load_op": "clear",
            "store_op": "store",
        }
        render_pass = encoder.begin_render_pass(label="present", color_attachments=[attachment])
        if view is not None:
            self._draw_bands(render_pass, view, (width, height))
        bindings = {panel: self._panel_binding(panel) for panel in panels}
        for panel, (_, bind_group) in bindings.items():
            panel_height, panel_width = panel.picture.shape[:2]
            left, top = panel.corner
            panel_height = min(panel_height, height - top)
            panel_width = min(panel_width, width - left)
            if panel_height > 0 and panel_width > 0:
                render_pass.set_pipeline(self._panels)
                render_pass.set_viewport(left, top, panel_width, panel_height, 0, 1)
                render_pass.set_bind_group(0, bind_group)
                render_pass.draw(3)
        render_pass.end()
        self._panel_bindings = bindings  # panels that are no longer shown are released
        self._device.submit(encoder)

    def _draw_bands(self, render_pass: RenderPass, view: View, surface: tuple[int, int]) -> None:
        """Draw each band of image rows on its rows of the surface; the last fills the rest."""
        width, height = surface
        self._bindings = {band.image: self._binding(band.image) for band in view.bands}
        render_pass.set_pipeline(self._pipeline)
        # A row belongs to the band that holds the pixel of the image at its centre.
        scale = height / view.camera.height
        band_tops = [math.ceil(band.first * scale - 0.5) for band in view.bands]
        for band, top, bottom in zip(view.bands, band_tops, [*band_tops[1:], height], strict=True):
            uniform, bind_group = self._bindings[band.image]
            self._device.write(uniform, _uniforms(view, band, surface))
            render_pass.set_bind_group(0, bind_group)
            render_pass.set_scissor_rect(0, top, width, bottom - top)
            render_pass.draw(3)
        render_pass.set_scissor_rect(0, 0, width, height)

    def _binding(self, image: Buffer) -> tuple[Buffer, BindGroup]:
        """Return the uniform and the bind group of an image, created when it is first shown."""
        if image in self._bindings:
            return self._bindings[image]
        uniform = self._device.uniform("showing", PRESENT_UNIFORM.itemsize)
        resources = [{"buffer": uniform}, {"buffer": image}]
        return uniform, _bind_group(self._device.raw, self._layout, resources)

    def _panel_binding(self, panel: Panel) -> tuple[Texture, BindGroup]:
        """Return the texture and the bind group of a panel, created when it is first shown."""
        if panel in self._panel_bindings:
            return self._panel_bindings[panel]
        raw = self._device.raw
        height, width = panel.picture.shape[:2]
        texture = raw.create_texture(
            label="panel",
            size=(width, height, 1),
            format="rgba8unorm",
            usage="TEXTURE_BINDING|COPY_DST",
        )
        raw.queue.write_texture(
            {"texture": texture},
            np.ascontiguousarray(panel.picture),
            {"bytes_per_row": 4 * width, "rows_per_image": height},
            (width, height, 1),
        )
        origin = self._device.uniform("origin of a panel", 16)
        self._device.write(origin, np.array([*panel.corner, 0, 0], np.float32))
        resources = [{"buffer": origin}, texture.create_view()]
        return texture, _bind_group(raw, self._panel_layout, resources)


def _uniforms(view: View, band: DrawnImage, surface: tuple[int, int]) -> np.ndarray:
    camera = view.camera
    uniforms = np.zeros(1, PRESENT_UNIFORM)
    # The rows of world → camera are the columns of camera → world.
    uniforms["turn"][0, :, :3] = camera.view[:3, :3]
    uniforms["size"] = camera.width, camera.height
    uniforms["scale"] = camera.width / surface[0], camera.height / surface[1]
    uniforms["row"], uniforms["first"] = band.row, band.first
    uniforms["mode"] = _NUMBER_BY_MODE[view.mode]
    uniforms["near"], uniforms["far"] = view.depths
    uniforms["is_linear"] = view.color_space == "linear"
    uniforms["background_alpha"] = 1.0
    return uniforms


def _bind_group(raw: RawDevice, layout: BindGroupLayout, resources: Sequence[object]) -> BindGroup:
    entries = [
        {"binding": binding, "resource": resource} for binding, resource in enumerate(resources)
    ]
    return raw.create_bind_group(layout=layout, entries=entries)

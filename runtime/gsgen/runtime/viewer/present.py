"""Present: what was drawn, and panels of words over it, on the surface of a window."""

__all__ = ["Panel", "Present", "View"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np
from jaxtyping import UInt8

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.shader import source
from gsgen.runtime.media.pictures import Mode
from gsgen.runtime.renderer.renderer import Drawn
from gsgen.runtime.scene.camera import Camera

_MODES: Final[dict[Mode, int]] = {
    "color": 0,
    "depth": 1,
    "median-depth": 2,
    "normal": 3,
    "alpha": 4,
}
_WORDS: Final = {
    "MODE_DEPTH": _MODES["depth"],
    "MODE_MEDIAN": _MODES["median-depth"],
    "MODE_NORMAL": _MODES["normal"],
    "MODE_ALPHA": _MODES["alpha"],
}
_SHOWING: Final = np.dtype(
    [
        ("turn", np.float32, (3, 4)),
        ("size", np.float32, 2),
        ("scale", np.float32, 2),
        ("row", np.uint32),
        ("mode", np.uint32),
        ("near", np.float32),
        ("far", np.float32),
        ("is_linear", np.uint32),
        ("filling", np.uint32, 3),
    ]
)
"""``RenderEvidence`` of ``present.wgsl``; a column of a matrix has room for four."""

_OVER: Final = {
    "src_factor": "one",
    "dst_factor": "one-minus-src-alpha",
    "operation": "add",
}


@final
@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A picture that lies over the surface.

    Attributes:
        picture: Red, green and blue multiplied by alpha, and alpha, sRGB.
        at: Pixels from the left and from the upper edge.
    """

    picture: UInt8[np.ndarray, "h w 4"]
    at: tuple[int, int]


@final
@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What was drawn, and how it is shown.

    Attributes:
        drawn: The image on the device.
        camera: Whose image it is.
        mode: What of it is shown; the image has to be of that output.
        depths: The depths that are white and nearly black.
        color_space: Of its colours.
    """

    drawn: Drawn
    camera: Camera
    mode: Mode
    depths: tuple[float, float] = (0.0, 1.0)
    color_space: Literal["srgb", "linear"] = "srgb"


@final
class Present:
    """``present.wgsl`` and ``panel.wgsl``.

    Args:
        device: Where the images are.
        format: Of the surfaces' textures; it has no curve of its own.
    """

    def __init__(self, device: Device, format: str) -> None:
        self._device, raw = device, device.raw
        self._uniform = device.uniform("showing", _SHOWING.itemsize)
        self._layout, self._pipeline = _pipeline(
            raw,
            "present",
            {"buffer": {"type": "read-only-storage"}},
            format,
            None,
            **_WORDS,
        )
        blend = {"color": _OVER, "alpha": _OVER}
        self._panel_layout, self._panels = _pipeline(
            raw, "panel", {"texture": {"sample_type": "float"}}, format, blend
        )
        self._bound: tuple[Any, Any] | None = None
        self._laid: dict[Panel, tuple[Any, Any]] = {}

    def __call__(self, target: Any, view: View | None, panels: Sequence[Panel]) -> None:
        """Show an image and panels.

        Args:
            target: The surface's texture, all of which the image is stretched over.
            view: The image; None for black.
            panels: From the lowest to the uppermost; what is beyond the surface is not seen.
        """
        width, height = target.size[:2]
        encoder = self._device.raw.create_command_encoder(label="present")
        attachment = {
            "view": target.create_view(),
            "clear_value": (0.0, 0.0, 0.0, 1.0),
            "load_op": "clear",
            "store_op": "store",
        }
        showing = encoder.begin_render_pass(label="present", color_attachments=[attachment])
        if view is not None:
            self._device.write(self._uniform, _showing(view, (width, height)))
            showing.set_pipeline(self._pipeline)
            showing.set_bind_group(0, self._bind(view.drawn.image))
            showing.draw(3)
        laid = {panel: self._lay(panel) for panel in panels}
        for panel, (_, bind) in laid.items():
            tall, panel_width = panel.picture.shape[:2]
            left, top = panel.at
            tall, panel_width = min(tall, height - top), min(panel_width, width - left)
            if tall > 0 and panel_width > 0:
                showing.set_pipeline(self._panels)
                showing.set_viewport(left, top, panel_width, tall, 0, 1)
                showing.set_bind_group(0, bind)
                showing.draw(3)
        showing.end()
        self._laid = laid  # what is no more shown goes
        self._device.submit(encoder)

    def _bind(self, image: Any) -> Any:
        if self._bound is None or self._bound[0] is not image:
            resources = [{"buffer": self._uniform}, {"buffer": image}]
            self._bound = image, _group(self._device.raw, self._layout, resources)
        return self._bound[1]

    def _lay(self, panel: Panel) -> tuple[Any, Any]:
        """Return the texture of a panel and what binds it, made when it is first seen."""
        if panel in self._laid:
            return self._laid[panel]
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
        self._device.write(origin, np.array([*panel.at, 0, 0], np.float32))
        resources = [{"buffer": origin}, texture.create_view()]
        return texture, _group(raw, self._panel_layout, resources)


def _showing(view: View, surface: tuple[int, int]) -> np.ndarray:
    camera = view.camera
    uniforms = np.zeros(1, _SHOWING)
    uniforms["turn"][0, :, :3] = camera.view[
        :3, :3
    ]  # its rows are the columns of camera → world
    uniforms["size"] = camera.width, camera.height
    uniforms["scale"] = camera.width / surface[0], camera.height / surface[1]
    uniforms["row"], uniforms["mode"] = view.drawn.row, _MODES[view.mode]
    uniforms["near"], uniforms["far"] = view.depths
    uniforms["is_linear"] = view.color_space == "linear"
    return uniforms


def _pipeline(
    raw: Any,
    name: str,
    resource: dict[str, Any],
    format: str,
    blend: dict[str, Any] | None,
    **constants: int,
) -> tuple[Any, Any]:
    """Return the layout and the pipeline of a shader with a uniform and one more binding."""
    layout = raw.create_bind_group_layout(
        label=name,
        entries=[
            {"binding": 0, "visibility": "FRAGMENT", "buffer": {"type": "uniform"}},
            {"binding": 1, "visibility": "FRAGMENT", **resource},
        ],
    )
    module = raw.create_shader_module(label=name, code=source(name, **constants))
    target = {"format": format} | ({"blend": blend} if blend else {})
    pipeline = raw.create_render_pipeline(
        label=name,
        layout=raw.create_pipeline_layout(bind_group_layouts=[layout]),
        vertex={"module": module, "entry_point": "corner_of", "buffers": []},
        primitive={"topology": "triangle-list"},
        fragment={"module": module, "entry_point": "color_at", "targets": [target]},
    )
    return layout, pipeline


def _group(raw: Any, layout: Any, resources: Sequence[Any]) -> Any:
    entries = [
        {"binding": binding, "resource": resource}
        for binding, resource in enumerate(resources)
    ]
    return raw.create_bind_group(layout=layout, entries=entries)

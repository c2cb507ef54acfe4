"""The painter of a viewer: what draws on a surface, on a device that may be lost."""

__all__ = ["SurfaceRenderer", "ViewRequest"]

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.media.pictures import MODES, Mode
from gsgen.runtime.renderer.rasteriser_choice import RasteriserOption
from gsgen.runtime.renderer.renderer import Drawn, Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.viewer.live_playback import LivePlayback
from gsgen.runtime.viewer.present import Panel, Present, View


@final
@dataclass(frozen=True, slots=True, eq=False)
class ViewRequest:
    """What is to be seen of a stage.

    Attributes:
        camera: From where, and how large.
        mode: What of it.
        background: Red, green, blue, alpha.
    """

    camera: Camera
    mode: Mode
    background: tuple[float, ...]

    def key(self, stage: LivePlayback) -> object:
        """Return what tells one picture from another."""
        camera = self.camera
        lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        camera_key = (camera.view.tobytes(), lens, camera.near)
        moving = stage.number if stage.post else 0
        settings_key = (stage.sh_degree, stage.antialias, stage.version, moving)
        return camera_key, self.mode, self.background, settings_key, id(stage)


@final
class SurfaceRenderer:
    """Draws stages on the surface of a window.

    Args:
        open_device: Opens a device, now and when one was lost.
        rasteriser: What blends, as :class:`Renderer` has it.
        compact: Keep Gaussians in fewer bytes, as :class:`Renderer` has it.

    Attributes:
        renderer: What draws.
        seconds: What drawing the last picture took.
        drawn: The last picture.

    Raises:
        DeviceUnavailable: There is nothing to draw with.
    """

    def __init__(
        self,
        open_device: Callable[[], Device] = Device.open,
        *,
        rasteriser: RasteriserOption = "auto",
        compact: bool = False,
    ) -> None:
        self._open = open_device
        self._rasteriser: RasteriserOption = rasteriser
        self._compact = compact
        self._uploads: Any = None
        self.seconds = 0.0
        self._begin()

    def _begin(self) -> None:
        self.renderer = Renderer(
            self._open(), rasteriser=self._rasteriser, compact=self._compact
        )
        self._present: Present | None = None
        self._configured: Any = None
        self._shown: tuple[object, View] | None = None
        self.drawn: Drawn | None = None

    def view(self, stage: LivePlayback, wish: ViewRequest) -> View:
        """Return a picture of a stage, drawn anew where anything is not as it was.

        Args:
            stage: What is drawn.
            wish: What is to be seen of it.

        Raises:
            CapacityExceeded: It is more than the device has room for.
            DeviceLost: The device went away.
            GsgenError: It cannot be drawn, or a post-process model fails.
        """
        if self._shown is not None and self._shown[0] == wish.key(stage):
            return self._shown[1]
        started = time.perf_counter()
        view = self._drawn(stage, wish)
        self.seconds, self.drawn = time.perf_counter() - started, view.drawn
        self._shown = wish.key(stage), view  # a post-process model may have moved the stage
        return view

    def show(self, context: Any, view: View | None, panels: Sequence[Panel]) -> None:
        """Show a picture, or nothing, and panels over it.

        Args:
            context: Of the surface, a rendercanvas ``WgpuContext``.
            view: Of :meth:`view`.
            panels: What lies over it.

        Raises:
            DeviceLost: The device went away.
        """
        device = self.renderer.device
        device.require()  # wgpu-native ends the process where a surface asks a lost device
        with device.translate_errors():
            self._show(device, context, view, panels)

    def _show(
        self, device: Device, context: Any, view: View | None, panels: Sequence[Panel]
    ) -> None:
        if self._present is None or self._configured is not context:
            # The shader makes bytes of sRGB itself, so that panels are blended as they look.
            preferred = context.get_preferred_format(device.raw.adapter)
            surface_format = preferred.removesuffix("-srgb")
            if context.get_configuration() is not None:
                context.unconfigure()  # its texture was of a device that is lost
            context.configure(device=device.raw, format=surface_format)
            self._present, self._configured = Present(device, surface_format), context
        self._present(context.get_current_texture(), view, panels)

    def _drawn(self, stage: LivePlayback, wish: ViewRequest) -> View:
        camera, output = wish.camera, MODES[wish.mode]
        self._shown = None  # its buffers may go now
        depths = stage.depths(camera)
        if stage.post and wish.mode == "color":
            player = stage.player(self.renderer, wish.background, output)
            frame = stage.frame(player, camera)
            drawn, camera = self._uploaded(frame), _resized(camera, frame)
            return View(drawn, camera, wish.mode, depths, frame.color_space)
        scene = stage.scene()
        drawn = self.renderer.draw(scene, camera, background=wish.background, output=output)
        return View(drawn, camera, wish.mode, depths, scene.color_space)

    def _uploaded(self, frame: Frame) -> Drawn:
        """Return a frame that came back from the device as if it had stayed there."""
        assert frame.rgba is not None  # colours were asked for
        device, size = self.renderer.device, frame.rgba.nbytes
        if self._uploads is None or self._uploads[:2] != (device, size):
            with device.translate_errors():
                self._uploads = device, size, device.storage("shown image", size)
        image = self._uploads[2]
        with device.translate_errors():
            device.write(image, np.ascontiguousarray(frame.rgba, np.float32))
        return Drawn(image, frame.rgba.shape[1], frame.visible, frame.pairs)

    def frame(self, stage: LivePlayback, wish: ViewRequest) -> Frame:
        """Return the picture as arrays; post-process models work on its colours.

        Raises:
            GsgenError: It cannot be drawn, or a model fails.
        """
        player = stage.player(self.renderer, wish.background, MODES[wish.mode])
        return stage.frame(player, wish.camera)

    def recover(self) -> None:
        """Open the device again; what is shown next is uploaded to it.

        Raises:
            DeviceUnavailable: There is none any more.
        """
        try:
            self._uploads = None
            self._begin()
        except DeviceUnavailable as error:
            message = (
                f"the graphics device was lost, and cannot be opened again: {error.message}"
            )
            raise DeviceUnavailable(message, hint=error.hint) from error


def _resized(camera: Camera, frame: Frame) -> Camera:
    assert frame.rgba is not None
    height, width = frame.rgba.shape[:2]
    return camera.scaled(width, height)

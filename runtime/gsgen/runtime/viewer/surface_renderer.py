"""Draws a playback on the surface of a window, and recovers from a lost GPU device."""

__all__ = ["SurfaceRenderer", "ViewRequest"]

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

import numpy as np

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.kernels.shared.kernel import VEC4
from gsgen.runtime.media.pictures import PICTURE_MODES, Mode
from gsgen.runtime.playback.live_playback import LivePlayback
from gsgen.runtime.renderer.bands import DrawnImage
from gsgen.runtime.renderer.rasteriser_choice import RasteriserOption
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.viewer.present import Panel, PresentPass, View

if TYPE_CHECKING:
    from rendercanvas.contexts import WgpuContext


@final
@dataclass(frozen=True, slots=True, eq=False)
class ViewRequest:
    """The camera, display mode and background with which a viewer draws its next picture."""

    camera: Camera
    mode: Mode
    background: tuple[float, ...]

    def key(self, playback: LivePlayback) -> object:
        """Return a key that changes when the viewer must draw its picture again."""
        camera = self.camera
        camera_key = (camera.view.tobytes(), camera.intrinsics, camera.near, camera.dilation)
        number = playback.number if playback.post else 0
        settings_key = (playback.sh_degree, playback.antialias, playback.version, number)
        return camera_key, self.mode, self.background, settings_key, id(playback)


@final
class SurfaceRenderer:
    """Draws playbacks on the surface of a window, and recovers from a lost device."""

    def __init__(
        self,
        open_device: Callable[[], Device] = Device.open,
        *,
        rasteriser: RasteriserOption = "auto",
        compact: bool = False,
    ) -> None:
        self._open_device = open_device
        self._rasteriser: RasteriserOption = rasteriser
        self._is_compact = compact
        self._upload: tuple[Device, list[int], list[Buffer]] | None = None
        self.seconds = 0.0
        self._begin()

    def _begin(self) -> None:
        self.renderer = Renderer(
            self._open_device(), rasteriser=self._rasteriser, compact=self._is_compact
        )
        self._present_pass: PresentPass | None = None
        self._configured_context: WgpuContext | None = None
        self._last_view: tuple[object, View] | None = None
        self.drawn: DrawnImage | None = None

    def view(self, playback: LivePlayback, request: ViewRequest) -> View:
        """Draw a picture of a playback, or return the last one if nothing has changed."""
        last = self._last_view
        # An unchanged picture may still lack splats that its counts have now told.
        if last is not None and last[0] == request.key(playback) and not self.renderer.settle():
            return last[1]
        started = time.perf_counter()
        view = self._draw(playback, request)
        self.seconds, self.drawn = time.perf_counter() - started, _summed_counts(view.bands)
        # The key is computed again: a post-process model may have taken a new frame.
        self._last_view = request.key(playback), view
        return view

    def show(self, context: "WgpuContext", view: View | None, panels: Sequence[Panel]) -> None:
        """Show a picture (black if None) on a window's surface, with panels drawn over it."""
        device = self.renderer.device
        device.require()  # wgpu-native aborts if a surface uses a lost device
        with device.translate_errors():
            self._show(device, context, view, panels)

    def _show(
        self, device: Device, context: "WgpuContext", view: View | None, panels: Sequence[Panel]
    ) -> None:
        if self._present_pass is None or self._configured_context is not context:
            # The shader encodes sRGB itself, so that panels are blended in sRGB.
            preferred_format = context.get_preferred_format(device.raw.adapter)
            surface_format = preferred_format.removesuffix("-srgb")
            if context.get_configuration() is not None:
                context.unconfigure()  # its texture belongs to a lost device
            context.configure(device=device.raw, format=surface_format)
            self._present_pass, self._configured_context = (
                PresentPass(device, surface_format),
                context,
            )
        self._present_pass(context.get_current_texture(), view, panels)

    def _draw(self, playback: LivePlayback, request: ViewRequest) -> View:
        camera, output = request.camera, PICTURE_MODES[request.mode]
        self._last_view = None  # its buffers may be reused now
        depths = playback.depths(camera)
        if playback.post and request.mode == "color":
            player = playback.player(self.renderer, request.background, output)
            frame = playback.frame(player, camera)
            bands, camera = self._upload_images(frame), _resize_camera(camera, frame)
            color_space = frame.color_space
        else:
            scene = playback.scene()
            color_space = scene.color_space
            # Software drivers are waited for: they have no frame to draw meanwhile.
            bands = self.renderer.draw_bands(
                scene,
                camera,
                background=request.background,
                output=output,
                wait=self.renderer.device.software,
            )
        return View(
            bands=bands, camera=camera, mode=request.mode, depths=depths, color_space=color_space
        )

    def _upload_images(self, frame: Frame) -> list[DrawnImage]:
        """Upload a frame that a post-process model computed on the CPU, in bands of rows."""
        assert frame.rgba is not None  # colours were drawn
        device, (height, width) = self.renderer.device, frame.rgba.shape[:2]
        rows = max(1, device.largest_binding // (VEC4 * width))
        bands = [
            np.ascontiguousarray(frame.rgba[first : first + rows], np.float32)
            for first in range(0, height, rows)
        ]
        sizes = [band.nbytes for band in bands]
        with device.translate_errors():
            if self._upload is None or self._upload[:2] != (device, sizes):
                images = [device.storage("shown image", size) for size in sizes]
                self._upload = device, sizes, images
            for image, band in zip(self._upload[2], bands, strict=True):
                device.write(image, band)
        return [
            # The first band has the counts of all.
            DrawnImage(
                image=image,
                row=width,
                visible=0 if first else frame.visible,
                pairs=0 if first else frame.pairs,
                first=first,
            )
            for first, image in zip(range(0, height, rows), self._upload[2], strict=True)
        ]

    def frame(self, playback: LivePlayback, request: ViewRequest) -> Frame:
        """Draw a picture of a playback as arrays, through its post-process models."""
        player = playback.player(self.renderer, request.background, PICTURE_MODES[request.mode])
        return playback.frame(player, request.camera)

    def recover(self) -> None:
        """Open the GPU device again after a loss; the next picture uploads the scene to it."""
        try:
            self._upload = None
            self._begin()
        except DeviceUnavailable as error:
            message = f"the graphics device was lost, and cannot be opened again: {error.message}"
            raise DeviceUnavailable(message, hint=error.hint) from error


def _summed_counts(bands: Sequence[DrawnImage]) -> DrawnImage:
    """Return the first band of rows of an image, with the summed splat counters of all bands."""
    visible, pairs = sum(band.visible for band in bands), sum(band.pairs for band in bands)
    return replace(bands[0], visible=visible, pairs=pairs)


def _resize_camera(camera: Camera, frame: Frame) -> Camera:
    assert frame.rgba is not None
    height, width = frame.rgba.shape[:2]
    return camera.scaled(width, height)

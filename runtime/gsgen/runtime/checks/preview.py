"""Draws small previews of splats and scenes in notebooks."""

__all__ = ["draw_preview"]

from importlib.util import find_spec

import numpy as np

from gsgen.formats import Splats
from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData

_PICTURE_WIDTH, _PICTURE_HEIGHT, _FOV_DEGREES = 480, 320, 50.0
_BACKGROUND_RGBA = (0.1, 0.11, 0.13, 1.0)


def draw_preview(value: object) -> bytes | None:
    """Return a PNG preview of splats or of a scene in memory; None if it cannot be drawn.

    Raises:
        SceneInvalid: The scene cannot be drawn.
    """
    if any(find_spec(package) is None for package in ("wgpu", "PIL")):
        return None
    if isinstance(value, Splats):
        value = SplatData.from_splats(value)
    scene = Scene([value]) if isinstance(value, SplatData) else value
    if not isinstance(scene, Scene) or not (scene.sets or scene.meshes):
        return None
    from gsgen.runtime.media.pictures import png_of
    from gsgen.runtime.playback.camera_options import FRAMING_MARGIN
    from gsgen.runtime.renderer.renderer import Renderer
    from gsgen.runtime.scene.camera import Camera
    from gsgen.runtime.sources.scene_source import sources_of

    boxes = [source.extent() for source in sources_of(scene)]
    center = np.mean([middle for middle, _ in boxes], axis=0)
    reach = max(np.linalg.norm(middle - center) + radius for middle, radius in boxes)
    radius = float(FRAMING_MARGIN * reach / np.sin(np.radians(_FOV_DEGREES) / 2))
    camera = Camera.orbit(
        center.tolist(),
        radius,
        azimuth=30.0,
        elevation=20.0,
        fov_y=_FOV_DEGREES,
        near=radius / 100,
        width=_PICTURE_WIDTH,
        height=_PICTURE_HEIGHT,
    )
    try:
        renderer = Renderer(rasteriser="tiles")
    except DeviceUnavailable:
        return None  # the table remains
    return png_of(renderer.render(scene, camera, background=_BACKGROUND_RGBA).srgb8[..., :3])

"""The wgpu runtime, which draws validated models and splat files.

    >>> from gsgen.formats import open_splats
    >>> from gsgen.runtime import Camera, Renderer, Scene, SplatData
    >>> scene = Scene([SplatData.from_splats(open_splats("garden.ply"))])
    >>> frame = Renderer().render(scene, Camera.look_at((0, -1, -4), (0, 0, 0)))

The names below are loaded when first used.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr
from gsgen.contract._notebook import draw_previews_with

if TYPE_CHECKING:
    from gsgen.runtime.baking.bake_frames import bake
    from gsgen.runtime.camera_files import CameraFile, open_cameras
    from gsgen.runtime.errors import CapacityExceeded, DeviceUnavailable, SceneInvalid
    from gsgen.runtime.gpu.device import Device
    from gsgen.runtime.playback.image_tiling import post_process
    from gsgen.runtime.playback.player import FrameRequest, GeneratorPlayer, Player
    from gsgen.runtime.playback.post_process import PostProcessor
    from gsgen.runtime.renderer.renderer import Renderer
    from gsgen.runtime.scene.camera import Camera
    from gsgen.runtime.scene.frame import NOTHING, Frame
    from gsgen.runtime.scene.mesh import Mesh, MeshData
    from gsgen.runtime.scene.scene import Box, Scene, SplatSet
    from gsgen.runtime.scene.splat_data import SplatData
    from gsgen.runtime.scene.splat_pool import PooledSet, SplatPool
    from gsgen.runtime.sources.mesh_files import read_mesh
    from gsgen.runtime.sources.scene_file import open_scene
    from gsgen.runtime.viewer.window import view

__all__ = [
    "NOTHING",
    "Box",
    "Camera",
    "CameraFile",
    "CapacityExceeded",
    "Device",
    "DeviceUnavailable",
    "Frame",
    "FrameRequest",
    "GeneratorPlayer",
    "Mesh",
    "MeshData",
    "Player",
    "PooledSet",
    "PostProcessor",
    "Renderer",
    "Scene",
    "SceneInvalid",
    "SplatData",
    "SplatPool",
    "SplatSet",
    "bake",
    "open_cameras",
    "open_scene",
    "post_process",
    "read_mesh",
    "view",
]


def _draw_preview(value: object) -> bytes | None:
    from gsgen.runtime.checks.preview import draw_preview

    return draw_preview(value)


draw_previews_with(_draw_preview)
__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)

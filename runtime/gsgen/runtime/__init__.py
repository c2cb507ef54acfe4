"""The wgpu runtime, which draws validated models and splat files.

    >>> from gsgen.formats import open_splats
    >>> from gsgen.runtime import Camera, Renderer, Scene, SplatData
    >>> scene = Scene([SplatData.from_splats(open_splats("garden.ply"))])
    >>> frame = Renderer().render(scene, Camera.look_at((0, -1, -4), (0, 0, 0)))

The names below are loaded when first used.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names
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
    from gsgen.runtime.scene.distortion import Distortion
    from gsgen.runtime.scene.frame import NOTHING, Frame
    from gsgen.runtime.scene.mesh import Mesh, MeshData
    from gsgen.runtime.scene.scene import Box, Scene, SplatSet
    from gsgen.runtime.scene.splat_data import SplatData
    from gsgen.runtime.scene.splat_pool import PooledSplatSet, SplatPool
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
    "Distortion",
    "Frame",
    "FrameRequest",
    "GeneratorPlayer",
    "Mesh",
    "MeshData",
    "Player",
    "PooledSplatSet",
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
# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "bake": "gsgen.runtime.baking.bake_frames",
    "CameraFile": "gsgen.runtime.camera_files",
    "open_cameras": "gsgen.runtime.camera_files",
    "CapacityExceeded": "gsgen.runtime.errors",
    "DeviceUnavailable": "gsgen.runtime.errors",
    "SceneInvalid": "gsgen.runtime.errors",
    "Device": "gsgen.runtime.gpu.device",
    "post_process": "gsgen.runtime.playback.image_tiling",
    "FrameRequest": "gsgen.runtime.playback.player",
    "GeneratorPlayer": "gsgen.runtime.playback.player",
    "Player": "gsgen.runtime.playback.player",
    "PostProcessor": "gsgen.runtime.playback.post_process",
    "Renderer": "gsgen.runtime.renderer.renderer",
    "Camera": "gsgen.runtime.scene.camera",
    "Distortion": "gsgen.runtime.scene.distortion",
    "NOTHING": "gsgen.runtime.scene.frame",
    "Frame": "gsgen.runtime.scene.frame",
    "Mesh": "gsgen.runtime.scene.mesh",
    "MeshData": "gsgen.runtime.scene.mesh",
    "Box": "gsgen.runtime.scene.scene",
    "Scene": "gsgen.runtime.scene.scene",
    "SplatSet": "gsgen.runtime.scene.scene",
    "SplatData": "gsgen.runtime.scene.splat_data",
    "PooledSplatSet": "gsgen.runtime.scene.splat_pool",
    "SplatPool": "gsgen.runtime.scene.splat_pool",
    "read_mesh": "gsgen.runtime.sources.mesh_files",
    "open_scene": "gsgen.runtime.sources.scene_file",
    "view": "gsgen.runtime.viewer.window",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)

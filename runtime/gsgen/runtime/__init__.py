"""The wgpu runtime: where validated models are drawn.

    >>> from gsgen.formats import open_splats
    >>> from gsgen.runtime import Camera, Renderer, Scene, SplatData
    >>> scene = Scene([SplatData.from_splats(open_splats("garden.ply"))])
    >>> frame = Renderer().render(scene, Camera.look_at((0, -1, -4), (0, 0, 0)))

The names below are loaded when first used.
"""

from typing import TYPE_CHECKING

from gsgen.contract.lazy import attributes

if TYPE_CHECKING:
    from gsgen.runtime.camera import Camera
    from gsgen.runtime.camera_files import CameraFile, open_cameras
    from gsgen.runtime.device import Device
    from gsgen.runtime.errors import CapacityExceeded, DeviceUnavailable, SceneInvalid
    from gsgen.runtime.frame import NOTHING, Frame
    from gsgen.runtime.renderer import Renderer
    from gsgen.runtime.scene import Box, Scene, SplatSet
    from gsgen.runtime.splat_data import SplatData

__all__ = [
    "NOTHING",
    "Box",
    "Camera",
    "CameraFile",
    "CapacityExceeded",
    "Device",
    "DeviceUnavailable",
    "Frame",
    "Renderer",
    "Scene",
    "SceneInvalid",
    "SplatData",
    "SplatSet",
    "open_cameras",
]

_HOME = {
    "NOTHING": "frame",
    "Box": "scene",
    "Camera": "camera",
    "CameraFile": "camera_files",
    "CapacityExceeded": "errors",
    "Device": "device",
    "DeviceUnavailable": "errors",
    "Frame": "frame",
    "Renderer": "renderer",
    "Scene": "scene",
    "SceneInvalid": "errors",
    "SplatData": "splat_data",
    "SplatSet": "scene",
    "open_cameras": "camera_files",
}

__getattr__ = attributes(__name__, _HOME)

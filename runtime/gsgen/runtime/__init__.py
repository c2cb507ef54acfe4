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
    from gsgen.runtime.mesh import Mesh, MeshData
    from gsgen.runtime.mesh_files import read_mesh
    from gsgen.runtime.player import GeneratorPlayer, Player, Shot
    from gsgen.runtime.renderer import Renderer
    from gsgen.runtime.scene import Box, Scene, SplatSet
    from gsgen.runtime.scene_file import open_scene
    from gsgen.runtime.splat_data import SplatData
    from gsgen.runtime.window import view

__all__ = [
    "NOTHING",
    "Box",
    "Camera",
    "CameraFile",
    "CapacityExceeded",
    "Device",
    "DeviceUnavailable",
    "Frame",
    "GeneratorPlayer",
    "Mesh",
    "MeshData",
    "Player",
    "Renderer",
    "Scene",
    "SceneInvalid",
    "Shot",
    "SplatData",
    "SplatSet",
    "open_cameras",
    "open_scene",
    "read_mesh",
    "view",
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
    "GeneratorPlayer": "player",
    "Mesh": "mesh",
    "MeshData": "mesh",
    "Player": "player",
    "Renderer": "renderer",
    "Scene": "scene",
    "SceneInvalid": "errors",
    "Shot": "player",
    "SplatData": "splat_data",
    "SplatSet": "scene",
    "open_cameras": "camera_files",
    "open_scene": "scene_file",
    "read_mesh": "mesh_files",
    "view": "window",
}

__getattr__ = attributes(__name__, _HOME)

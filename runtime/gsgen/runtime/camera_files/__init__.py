"""Reads files of cameras: one reader per format, recognised by the content.

    >>> from gsgen.runtime import open_cameras
    >>> file = open_cameras("garden/transforms.json")
    >>> camera = file.pick("DSC08116.JPG")[0].camera

Cameras are in the OpenCV convention, in the world of the file.
"""

from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.camera_files.opening import open_cameras, split_pick

__all__ = ["CameraFile", "NamedCamera", "open_cameras", "split_pick"]

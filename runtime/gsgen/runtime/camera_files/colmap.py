"""Reads the cameras of COLMAP models: folders with cameras and images as .bin or .txt.

An image has the pose world → camera, as a quaternion (w, x, y, z) and a translation, in the axes of
``Camera``: +x right, +y down, +z forward (COLMAP's documentation, "Output Format" and "Camera
Models").
"""

__all__ = ["COLMAP_FOLDERS", "model_folder", "read_colmap"]

import math
from pathlib import Path
from typing import Final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.runtime.camera_files import colmap_binary, colmap_text
from gsgen.runtime.camera_files.colmap_models import ColmapImage, ColmapLens, intrinsics
from gsgen.runtime.camera_files.fields import camera_at
from gsgen.runtime.camera_files.file import CameraFile, NamedCamera
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.natural_order import natural_key

COLMAP_FOLDERS: Final = ("", "sparse/0", "sparse", "colmap/sparse/0", "0")
"""Folders of a data set that may hold a COLMAP model."""


def model_folder(folder: Path) -> Path | None:
    """Find the folder with the COLMAP model of a data set; None without one."""
    for part in COLMAP_FOLDERS:
        for suffix in ("bin", "txt"):
            names = (f"cameras.{suffix}", f"images.{suffix}")
            if all((folder / part / name).is_file() for name in names):
                return folder / part
    return None


def read_colmap(folder: Path) -> CameraFile:
    """Read the COLMAP model in a folder that :func:`model_folder` returned."""
    if (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file():
        lenses = colmap_binary.lenses(folder / "cameras.bin")
        images = colmap_binary.images(folder / "images.bin")
    else:
        lenses = colmap_text.lenses(folder / "cameras.txt")
        images = colmap_text.images(folder / "images.txt")
    if not images:
        raise ConfigInvalid(
            "the COLMAP model has no images, expected at least one", where=str(folder)
        )
    ordered_images = sorted(images, key=lambda image: natural_key(image.name))
    cameras = tuple(
        NamedCamera(image.name, _camera(image, lenses, folder)) for image in ordered_images
    )
    return CameraFile(path=str(folder), format="a model of COLMAP", cameras=cameras)


def _camera(image: ColmapImage, lenses: dict[int, ColmapLens], folder: Path) -> Camera:
    where = f"{folder}, image {image.name!r}"
    lens = lenses.get(image.lens)
    if lens is None:
        raise ConfigInvalid(
            f"the image refers to camera {image.lens}, expected one of {sorted(lenses)[:8]}",
            where=where,
        )
    values = intrinsics(lens.model, lens.values, where)
    view = np.eye(4)
    length = math.hypot(*image.quaternion)
    if not 0 < length < math.inf:
        message = f"has the quaternion {list(image.quaternion)}, expected one with a length"
        raise ConfigInvalid(message, where=where)
    view[:3, :3] = rotation_matrix(np.array([image.quaternion]) / length)[0]
    view[:3, 3] = image.translation
    return camera_at(where, view=view, width=lens.width, height=lens.height, **values)

"""Pairs of parallel eyes: their cameras, and their frames side by side."""

__all__ = ["beside", "eye_frames", "pair_of_eyes"]

from dataclasses import replace
from typing import Any

import numpy as np

from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.camera_numbers import require_number
from gsgen.runtime.scene.frame import Frame


def pair_of_eyes(camera: Camera, distance: float) -> tuple[Camera, Camera]:
    """Return the cameras of a left and a right eye, which look the same way as a camera between them.

    Args:
        camera: A pinhole or a fisheye.
        distance: Of the eyes from each other, in world units.

    Raises:
        SceneInvalid: The distance is not positive, or the camera is of another kind.
    """
    require_number("eye distance", distance, must_be_positive=True)
    if camera.kind not in ("pinhole", "fisheye"):
        reason = "has no perspective" if camera.kind == "orthographic" else "looks to all sides"
        raise SceneInvalid(
            f"is {camera.kind}, which {reason}, expected a pinhole or a fisheye for two eyes",
            where="camera.kind",
        )
    # An eye at the left sees everything farther right in its own space.
    offset = np.zeros((4, 4))
    offset[0, 3] = distance / 2
    return replace(camera, view=camera.view + offset), replace(camera, view=camera.view - offset)


def beside(left: Frame, right: Frame) -> Frame:
    """Return the frames of two eyes as one, the left one at the left; the larger count counts."""
    counts = {name: max(getattr(left, name), getattr(right, name)) for name in ("visible", "pairs")}
    joined: dict[str, Any] = {
        name: np.concatenate([image, getattr(right, name)], axis=1)
        for name, image in _images(left).items()
    }
    return replace(left, **joined, **counts)


def eye_frames(frame: Frame) -> tuple[Frame, Frame]:
    """Return the left and the right half of a frame of two eyes, as views."""
    width = frame.alpha.shape[1] // 2
    left: dict[str, Any] = {name: image[:, :width] for name, image in _images(frame).items()}
    right: dict[str, Any] = {name: image[:, width:] for name, image in _images(frame).items()}
    return replace(frame, **left), replace(frame, **right)


def _images(frame: Frame) -> dict[str, np.ndarray]:
    """Return the images of a frame that were drawn, by name."""
    names = ("rgba", "alpha", "depth", "median_depth", "ids", "normal")
    images = {name: getattr(frame, name) for name in names}
    return {name: image for name, image in images.items() if image is not None}

"""Reads reference images: pictures in a model's folder that the model must draw."""

__all__ = [
    "BACKGROUND",
    "MAX_DECIBELS",
    "MAX_REFERENCES",
    "MAX_SIDE",
    "ReferenceUnreadable",
    "image_decibels",
    "read_reference",
    "reference_camera",
]

import hashlib
import io
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32, UInt8

from gsgen.contract.errors import GsgenError
from gsgen.contract.model.files_beside import FileRefused, find_contained_file
from gsgen.contract.spec.manifest import ReferenceImage
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr

BACKGROUND: Final = (0.0, 0.0, 0.0, 1.0)
"""The background of reference images, which have no alpha."""

MAX_REFERENCES: Final = 16
"""Most reference images of a model that are compared."""

_MAX_BYTES: Final = 32 << 20
MAX_SIDE: Final = 4096
_MAX_COMPONENT: Final = 255
MAX_DECIBELS: Final = 200.0
"""The largest ratio that is told, that of equal pictures: rounding hides more."""


def image_decibels(
    drawn: UInt8[np.ndarray, "h w c"], expected: Float32[np.ndarray, "h w 3"]
) -> float:
    """Return the peak signal-to-noise ratio of a drawn frame against a picture, in decibels.

    Args:
        drawn: The frame, as sRGB bytes.
        expected: The picture, in [0, 1].
    """
    return min(psnr(drawn[..., :3] / _MAX_COMPONENT, expected), MAX_DECIBELS)


class ReferenceUnreadable(GsgenError):
    """Raised if a reference image is missing, outside its folder, altered, too large, not a PNG."""


def read_reference(model: Path, reference: ReferenceImage) -> Float32[np.ndarray, "h w 3"]:
    """Read a reference image beside a model, as red, green and blue in [0, 1]."""
    image_bytes = _read_image_bytes(model, reference.path)
    digest = hashlib.sha256(image_bytes).hexdigest()
    if digest != reference.sha256:
        raise ReferenceUnreadable(f"the image's sha256 is {digest}, expected {reference.sha256}")
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(image_bytes), formats=["PNG"]) as image:
            if max(image.size) > MAX_SIDE:
                raise ReferenceUnreadable(
                    f"the image is {image.width}×{image.height}, expected at most "
                    f"{MAX_SIDE}×{MAX_SIDE}"
                )
            colors = np.asarray(image.convert("RGB"), np.float32)
    except (
        Image.DecompressionBombError,
        UnidentifiedImageError,
        OSError,
        ValueError,
        SyntaxError,
    ) as error:
        raise ReferenceUnreadable(f"the image cannot be read as PNG: {error}") from error
    return colors / np.float32(_MAX_COMPONENT)


def reference_camera(reference: ReferenceImage, width: int, height: int) -> Camera:
    """Return the camera of a reference image."""
    if len(reference.view) != 3:
        raise SceneInvalid(
            f"the view matrix has {len(reference.view)} rows, expected 3", where="view"
        )
    view = np.eye(4)
    view[:3] = reference.view
    (fx, fy), (cx, cy) = reference.focal, reference.center
    return Camera(view, fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)


def _read_image_bytes(model: Path, name: str) -> bytes:
    try:
        with find_contained_file(model, name).open("rb") as file:
            image_bytes = file.read(_MAX_BYTES + 1)
    except FileRefused as error:
        raise ReferenceUnreadable(
            f"the reference image {name!r}: {error.actual}, expected {error.expected}"
        ) from error
    except OSError as error:
        raise ReferenceUnreadable(f"the image cannot be read: {error.strerror}") from error
    if len(image_bytes) > _MAX_BYTES:
        raise ReferenceUnreadable(f"the image has more than {_MAX_BYTES:,} bytes, the limit")
    return image_bytes

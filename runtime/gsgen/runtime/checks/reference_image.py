"""Reference images: pictures beside a model that it must draw, read within bounds."""

__all__ = [
    "BEHIND",
    "MOST_REFERENCES",
    "ReferenceUnreadable",
    "read_reference",
    "reference_camera",
]

import hashlib
import io
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np
from jaxtyping import Float32

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.manifest import ReferenceImage
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.scene.camera import Camera

BEHIND: Final = (0.0, 0.0, 0.0, 1.0)
"""What is behind the pictures, which have no alpha."""

MOST_REFERENCES: Final = 16
"""How many pictures of a model are looked at."""

_MOST_BYTES: Final = 32 << 20
_MOST_SIDE: Final = 4096
_MOST_COMPONENT: Final = 255


class ReferenceUnreadable(GsgenError):
    """The file is missing, another one, elsewhere, or no PNG of a size to compare."""


def read_reference(folder: Path, reference: ReferenceImage) -> Float32[np.ndarray, "h w 3"]:
    """Return red, green and blue in [0, 1] of a declared picture.

    Args:
        folder: The model's.
        reference: What the manifest says of it.

    Raises:
        ReferenceUnreadable: There is no such picture.
    """
    raw = _bytes(folder, reference.path)
    digest = hashlib.sha256(raw).hexdigest()
    if digest != reference.sha256:
        raise ReferenceUnreadable(f"sha256 {digest}, the manifest has {reference.sha256}")
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(raw), formats=["PNG"]) as image:
            if max(image.size) > _MOST_SIDE:
                raise ReferenceUnreadable(
                    f"{image.width}×{image.height} pixels, {_MOST_SIDE} a side at most"
                )
            colors = np.asarray(image.convert("RGB"), np.float32)
    except (
        Image.DecompressionBombError,
        UnidentifiedImageError,
        OSError,
        ValueError,
        SyntaxError,
    ) as error:
        raise ReferenceUnreadable(f"no PNG that can be read: {error}") from error
    return colors / np.float32(_MOST_COMPONENT)


def reference_camera(reference: ReferenceImage, width: int, height: int) -> Camera:
    """Return the camera that a declared picture was taken by.

    Raises:
        SceneInvalid: The manifest's numbers are no camera.
    """
    if len(reference.view) != 3:
        raise SceneInvalid(f"has {len(reference.view)} rows, wanted 3", where="view")
    view = np.eye(4)
    view[:3] = reference.view
    (fx, fy), (cx, cy) = reference.focal, reference.center
    return Camera(view, fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)


def _bytes(folder: Path, name: str) -> bytes:
    parts = PurePosixPath(name)
    inside = folder.resolve()
    path = (inside / parts).resolve()
    if "\\" in name or parts.is_absolute() or not path.is_relative_to(inside):
        raise ReferenceUnreadable("not in the model's folder")
    try:
        if not path.is_file():
            raise ReferenceUnreadable("no such file beside the model")
        with path.open("rb") as file:
            raw = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise ReferenceUnreadable(f"cannot be read: {error.strerror}") from error
    if len(raw) > _MOST_BYTES:
        raise ReferenceUnreadable(f"more than {_MOST_BYTES:,} bytes")
    return raw

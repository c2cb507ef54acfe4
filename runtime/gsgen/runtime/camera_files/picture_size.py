"""Returns the sizes of the pictures that a camera file names, for files without sizes."""

__all__ = ["picture_size"]

from pathlib import Path
from typing import Final

from gsgen.contract.errors import ConfigInvalid

_PICTURE_SUFFIXES: Final = ("", ".png", ".jpg", ".jpeg")  # NeRF's synthetic scenes omit the suffix


def picture_size(
    folder: Path, name: str, default: tuple[int, int] | None, where: str
) -> tuple[int, int]:
    """Return width and height of a camera's picture, in pixels.

    Args:
        folder: The folder of the camera file.
        name: Name of the picture, relative to the folder, with or without its suffix.
        default: The size of a picture that does not exist; None if the caller knows no size.
        where: The camera's location in the file, for error messages.

    Raises:
        ConfigInvalid: There is neither a picture nor a default.
    """
    from PIL import Image

    for suffix in _PICTURE_SUFFIXES:
        file = folder / (name + suffix)
        try:
            if file.is_file():  # a pipe would never end
                with Image.open(file) as picture:
                    return picture.size
        except (OSError, ValueError, Image.DecompressionBombError):
            continue  # unreadable: try the next name
    if default is None:
        raise ConfigInvalid(
            f"the file has no image size, and there is no picture {name!r} to take it from",
            where=where,
            hint="Give the size of the pictures: --size WIDTHxHEIGHT.",
        )
    return default

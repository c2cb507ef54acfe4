"""Checks before anything is drawn whether frames can be written to an output path."""

__all__ = ["require_output_format"]

from pathlib import Path
from typing import Final, Literal

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import refuse_folder
from gsgen.runtime.media import deep_pictures, mp4, pictures

_PICTURE_SUFFIXES: Final = (*pictures.IMAGE_SUFFIXES, deep_pictures.EXR_SUFFIX)


def require_output_format(path: Path, *, frames: int = 1, bits: Literal[8, 16] = 8) -> None:
    """Raise if frames cannot be written to a path: by its suffix, or for a missing package.

    Args:
        path: An image file, an .exr, an .npy, an .mp4, a .gif, or a folder.
        frames: Number of frames.
        bits: Bits of each channel of PNG files.

    Raises:
        ConfigInvalid: The suffix is unknown, or unfit for several frames or for the bits.
        SceneInvalid: A package that writes such files is not installed.
    """
    suffix = path.suffix.lower()
    is_folder = not suffix or path.is_dir()
    if bits != 8 and not (is_folder or suffix == ".png"):
        raise ConfigInvalid(
            f"{bits} bits are written as .png alone, not as {suffix}",
            where="--bits",
            hint="Give a .png or a folder; an .exr has 32 bits.",
        )
    known_suffixes = (*_PICTURE_SUFFIXES, *pictures.VIDEO_SUFFIXES, ".npy")
    if suffix in known_suffixes and not (frames > 1 and suffix in _PICTURE_SUFFIXES):
        refuse_folder(path)
    if frames > 1 and suffix in _PICTURE_SUFFIXES and not is_folder:
        raise ConfigInvalid(
            f"is one picture, expected a video or a folder for {frames} frames",
            where=str(path),
            hint="Give a folder, an .mp4, a .gif or an .npy.",
        )
    if not is_folder and suffix not in known_suffixes:
        raise ConfigInvalid(
            f"has the unknown suffix {path.suffix!r}",
            where=str(path),
            hint=f"Known: {', '.join(known_suffixes)}, or a folder.",
        )
    _require_packages(suffix, bits)


def _require_packages(suffix: str, bits: Literal[8, 16]) -> None:
    """Raise if a package that writes files of this suffix is not installed."""
    if suffix == ".npy":
        return
    if suffix == deep_pictures.EXR_SUFFIX:
        deep_pictures.exr_package()
    elif bits == 16:
        deep_pictures.png_package()
    else:
        pictures.require_pillow()
    if suffix == ".mp4":
        mp4.require_encoder()

"""Recognises camera files of other programs that cannot be read, with the way to a readable file."""

__all__ = ["unreadable_camera_file"]

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.file_kinds.recognition import kind_of_file


@final
@dataclass(frozen=True, slots=True)
class _Program:
    """How files of one program begin, what they are, and which export can be read."""

    pattern: re.Pattern[bytes]
    title: str
    way_out: str


_COLMAP_EXPORT: Final = "Export the cameras as COLMAP (text or binary)."
_PHOTOGRAMMETRY_PROGRAMS: Final = (
    _Program(
        re.compile(rb"Ogawa|\x89HDF\r\n"),
        "an Alembic file",
        "Export the camera's frames as transforms.json, for example with BlenderNeRF.",
    ),
    _Program(
        re.compile(rb"#\s*name\s*,\s*x\s*,\s*y\s*,", re.IGNORECASE),
        "a camera table of RealityCapture (RealityScan)",
        "Export the registration as COLMAP or Bundler, or convert it with "
        "`ns-process-data realitycapture`.",
    ),
    _Program(
        re.compile(rb".*(xcr:|capturingreality)", re.IGNORECASE | re.DOTALL),
        "metadata (XMP) of RealityCapture",
        "Export the registration as COLMAP or Bundler.",
    ),
    _Program(re.compile(rb"NVM_V3"), "a VisualSFM file (.nvm)", _COLMAP_EXPORT),
    _Program(
        re.compile(rb"PXR-USDC|#usda"),
        "a USD stage",
        "Export the camera's frames as transforms.json, for example with BlenderNeRF.",
    ),
    _Program(
        re.compile(rb"Kaydara FBX Binary|; FBX"),
        "an FBX file",
        "Export the camera's frames as transforms.json, for example with BlenderNeRF.",
    ),
    _Program(
        re.compile(rb"PK\x03\x04"),
        "a ZIP archive, such as a project of Metashape (.psx, .psz)",
        "Unpack it; of Metashape, export the cameras as Agisoft XML or COLMAP.",
    ),
    _Program(
        re.compile(rb"\s*<"),
        "an XML file",
        "The XML of Metashape (`Export cameras`) is read; of other programs, export COLMAP.",
    ),
)


def unreadable_camera_file(start: bytes, path: Path, supported_formats: str) -> ConfigInvalid:
    """Return the error for a file whose cameras cannot be read: what it is, and the way out.

    Args:
        start: The file's first bytes, at least a hundred.
        path: Path of the file.
        supported_formats: A sentence on the supported formats.
    """
    kind = kind_of_file(path)
    is_download_fault = kind is not None and kind.name in ("html", "error")
    for program in () if is_download_fault else _PHOTOGRAMMETRY_PROGRAMS:
        if program.pattern.match(start):
            message = f"is {program.title}, expected a camera file that gsgen reads"
            return ConfigInvalid(
                message, where=str(path), hint=f"{program.way_out} {supported_formats}"
            )
    if kind is not None and kind.name not in ("json", "text"):
        message = f"is {kind.title}, expected a camera file"
        return ConfigInvalid(
            message, where=str(path), hint=f"{kind.hint} {supported_formats}".strip()
        )
    return ConfigInvalid(
        f"begins with {start[:16]!r}, expected a camera file",
        where=str(path),
        hint=supported_formats,
    )

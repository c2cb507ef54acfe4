"""Unpacks a file of a ZIP archive, such as its one model or mesh, with the files beside it."""

__all__ = ["unpack_into", "unpack_member"]

import zipfile
import zlib
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.file_kinds.kind import DOWNLOAD_AGAIN_HINT
from gsgen.contract.file_kinds.names import MESH_SUFFIXES
from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, kind_of, kind_of_file
from gsgen.contract.inputs.addresses import is_plain_location

_UNPACKED_KINDS: Final = ("onnx", "glb", "gltf", "obj", "stl", "ply-mesh")
_UNPACKED_SUFFIXES: Final = (".onnx", *MESH_SUFFIXES)
_MAX_UNPACKED_BYTES: Final = 4 << 30
_MAX_MEMBERS: Final = 4096
_CHUNK_BYTES: Final = 1 << 20
_ARCHIVE_FAULTS: Final = (
    zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError,
    FileExistsError, NotADirectoryError, IsADirectoryError,
)  # fmt: skip


def unpack_into(new_folder: Callable[[], Path], archive: Path) -> Path | None:
    """Unpack an archive of one model or mesh into a new folder, and return the file's path.

    Members whose names lead out of the folder, and hidden ones, stay packed.

    Returns:
        None if the archive holds other files than one model or mesh, such as splats, which
        ``gsgen.formats`` reads from the archive.

    Raises:
        InputUnreadable: The archive is damaged, or unpacks to too much.
    """
    kind = kind_of_file(archive)
    if kind is None or kind.name != "zip":
        return None
    try:
        with zipfile.ZipFile(archive) as members:
            entries = [entry for entry in members.infolist() if _is_content(entry)]
            names = [entry.filename for entry in entries if _is_unpacked(members, entry)]
            if len(names) != 1 or len(entries) > _MAX_MEMBERS:
                return None
            _require_plausible_size(archive, entries)
            folder = new_folder()
            for entry in entries:
                _unpack(members, entry, folder / entry.filename)
    except _ARCHIVE_FAULTS as error:
        raise _damage(archive, error) from error
    return folder / names[0]


def unpack_member(folder: Path, archive: Path, member: str) -> Path:
    """Unpack a member of an archive, with the files in and below its folder, and return its path.

    Args:
        folder: Receives the files.
        archive: The archive.
        member: Path of the member in it, with slashes.

    Raises:
        InputUnreadable: The archive has no such member, is damaged, or unpacks to too much.
    """
    try:
        with zipfile.ZipFile(archive) as members:
            content = [entry for entry in members.infolist() if _is_content(entry)]
            names = [entry.filename for entry in content]
            if member not in names:
                nearest = get_close_matches(member, names, n=1, cutoff=0.0)
                raise InputUnreadable(
                    "the archive has no such file",
                    where=f"{archive}/{member}",
                    hint=f"It has {len(names)}, such as {', '.join(nearest)}.",
                )
            beside = member.rpartition("/")[0]
            entries = [entry for entry in content if entry.filename.startswith(beside)]
            _require_plausible_size(archive, entries)
            for entry in entries:
                _unpack(members, entry, folder / entry.filename)
    except _ARCHIVE_FAULTS as error:
        raise _damage(archive, error) from error
    return folder / member


def _damage(archive: Path, error: Exception) -> InputUnreadable:
    message = f"the archive cannot be unpacked: {error}"
    return InputUnreadable(message, where=str(archive), hint=DOWNLOAD_AGAIN_HINT)


def _is_content(entry: zipfile.ZipInfo) -> bool:
    parts = entry.filename.split("/")
    is_hidden = any(part.startswith(".") or part == "__MACOSX" for part in parts)
    return not (entry.is_dir() or is_hidden) and is_plain_location(entry.filename)


def _is_unpacked(members: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bool:
    """Return whether a member is a model or a mesh, by its first bytes and its suffix."""
    if not entry.filename.lower().endswith(_UNPACKED_SUFFIXES):
        return False
    with members.open(entry) as stream:
        kind = kind_of(stream.read(RECOGNITION_BYTES))
    # Binary STL files have no signature.
    return kind.name in _UNPACKED_KINDS if kind else entry.filename.lower().endswith(".stl")


def _require_plausible_size(archive: Path, entries: list[zipfile.ZipInfo]) -> None:
    size = sum(entry.file_size for entry in entries)
    if size > _MAX_UNPACKED_BYTES:
        raise InputUnreadable(
            f"the archive unpacks to {size:,} bytes, expected {_MAX_UNPACKED_BYTES:,} or fewer",
            where=str(archive),
            hint="If you trust it, unpack it, and name the file.",
        )


def _unpack(members: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> None:
    """Unpack a member; ``zipfile`` stops at the size that was checked."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with members.open(entry) as stream, path.open("xb") as file:
        while piece := stream.read(_CHUNK_BYTES):
            file.write(piece)

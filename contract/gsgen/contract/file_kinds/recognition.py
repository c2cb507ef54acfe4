"""Tells the kind of a file from its first bytes, and for an archive from the names within."""

__all__ = ["RECOGNITION_BYTES", "archive_kind", "content_kind", "kind_of", "kind_of_file"]

import errno
import os
import stat
import zipfile
import zlib
from collections.abc import Sequence
from io import BytesIO
from typing import BinaryIO, Final

from gsgen.contract.file_kinds.kind import (
    DOWNLOAD_AGAIN_HINT,
    EXPORT_SPLATS_HINT,
    MESH_RENDER_HINT,
    SPLATS,
    TILESET,
    UNPACK,
    FileKind,
)
from gsgen.contract.file_kinds.names import META_FILE, SPLAT_SUFFIXES, STREAMED_META
from gsgen.contract.file_kinds.signatures import kind_by_signature
from gsgen.contract.file_kinds.text_kinds import SPLAT_EXTENSION, decoded_text, ply_kind, text_kind

RECOGNITION_BYTES: Final = 1 << 16
"""The bytes at the beginning of a file that decide."""

_ZIP_FILE_MAGIC, _GZIP_MAGIC = b"PK\x03\x04", b"\x1f\x8b"
_CHECKPOINT_HINT: Final = (
    "`gsgen render` and `gsgen export static` take those of gsplat, nerfstudio and 3DGS, and "
    "`gsgen export` those of the methods that `gsgen plugins` lists."
)
_MAX_NESTING: Final = 2
_MAX_LISTED_MEMBERS: Final = 4


def kind_of_file(path: str | os.PathLike[str]) -> FileKind | None:
    """Return the kind of the file at ``path``; None if its content is not known.

    Raises:
        OSError: The file cannot be read.
    """
    mode = os.stat(path).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # opening a pipe waits for its writer
        raise OSError(errno.EINVAL, "the path is a device, pipe or socket", os.fspath(path))
    with open(path, "rb") as file:
        head = file.read(RECOGNITION_BYTES)
        return kind_of(head, file)


def kind_of(head: bytes, file: BinaryIO | None = None) -> FileKind | None:
    """Return the kind of a file from its first bytes; None if its content is not known.

    Args:
        head: The first ``RECOGNITION_BYTES`` bytes, or the whole of a smaller file.
        file: The file, whose list of members says what a ZIP archive holds.
    """
    return _kind(head, file, 0)


def _kind(head: bytes, file: BinaryIO | None, nesting_depth: int) -> FileKind | None:
    if head.startswith(_ZIP_FILE_MAGIC):
        return _zip_kind(head, file)
    if head.startswith(_GZIP_MAGIC):
        return _gzip_kind(head, nesting_depth)
    return content_kind(head)


def content_kind(head: bytes) -> FileKind | None:
    """Return the kind of a file that is neither ZIP nor gzip; None if its content is not known.

    `make web` translates it for web pages.
    """
    if not head:
        hint = "Write or download it again: the program that wrote it may have failed."
        return FileKind(name="empty", title="an empty file (0 bytes)", hint=hint)
    if head.startswith((b"ply\n", b"ply\r")):
        return ply_kind(head)
    if head.startswith(b"glTF"):
        return _glb_kind(head)
    kind = kind_by_signature(head)
    if kind is not None:
        return kind
    text = decoded_text(head)
    if text is not None:
        return text_kind(text)
    if head.count(b"\0") == len(head):
        return FileKind(
            name="zeros", title="a file that begins with zeros only", hint=DOWNLOAD_AGAIN_HINT
        )
    return None


def _glb_kind(head: bytes) -> FileKind:
    if head[4:8] == b"\x01\0\0\0":
        return FileKind(name="glb", title="a GLB file of version 1", hint=EXPORT_SPLATS_HINT)
    if SPLAT_EXTENSION.encode() in head or b'"_ROTATION"' in head:
        return FileKind(name="glb-splats", title="a GLB file of splats", hint=SPLATS)
    return FileKind(name="glb", title="a GLB file without splats", hint=MESH_RENDER_HINT)


def _gzip_kind(head: bytes, nesting_depth: int) -> FileKind:
    try:
        content = zlib.decompressobj(wbits=31).decompress(head, RECOGNITION_BYTES)
    except zlib.error:
        return FileKind(name="gzip", title="a damaged gzip file", hint=DOWNLOAD_AGAIN_HINT)
    if content.startswith(b"NGSP"):
        return FileKind(name="spz", title="an SPZ file of splats", hint=SPLATS)
    unpacked_kind = None
    if content and nesting_depth < _MAX_NESTING:
        unpacked_kind = _kind(content, None, nesting_depth + 1)
    title = f"a gzip file of {unpacked_kind.title}" if unpacked_kind else "a gzip file"
    return FileKind(name="gzip", title=title, hint=UNPACK)


def _zip_kind(head: bytes, file: BinaryIO | None) -> FileKind:
    stream = BytesIO(head) if file is None else file
    try:
        with zipfile.ZipFile(stream) as archive:
            return archive_kind(archive.namelist())
    except Exception:
        if file is None:
            return FileKind(name="zip", title="a ZIP archive", hint=UNPACK)
        title = "a damaged or cut off ZIP archive"
        return FileKind(name="damaged-zip", title=title, hint=DOWNLOAD_AGAIN_HINT)


def archive_kind(names: Sequence[str]) -> FileKind:
    """Return the kind of a ZIP archive from the names of its members."""
    files = [name for name in names if not (name.endswith("/") or _is_hidden(name))]
    base_names = {name.rpartition("/")[2].lower() for name in files}
    suffixes = {_suffix(name) for name in files}
    if "data.pkl" in base_names:
        is_script = "constants.pkl" in base_names
        title = "a network in TorchScript" if is_script else "a checkpoint of torch"
        hint = _CHECKPOINT_HINT
        return FileKind(name="torchscript" if is_script else "torch", title=title, hint=hint)
    if files and suffixes == {".npy"}:
        return FileKind(name="npz", title="an NPZ archive of NumPy arrays", hint=SPLATS)
    if "tileset.json" in base_names or "@3dtilesindex1@" in base_names:
        return FileKind(name="3tz", title="an archive of a tileset (3TZ)", hint=TILESET)
    if STREAMED_META in base_names:
        title = "a ZIP archive of a streamed SOG"
        return FileKind(name="streamed-sog", title=title, hint="Unpack it, and name lod-meta.json.")
    if META_FILE in base_names and ".webp" in suffixes:
        return FileKind(name="sog", title="a SOG file of splats", hint=SPLATS)
    if files and _suffix(files[0]) in (".usda", ".usdc", ".usd"):
        return FileKind(name="usd", title="a USD archive (usdz)", hint=EXPORT_SPLATS_HINT)
    if "[content_types].xml" in base_names:
        return FileKind(
            name="office", title="an office document or 3MF model", hint=EXPORT_SPLATS_HINT
        )
    listed_names = ", ".join(files[:_MAX_LISTED_MEMBERS]) + (
        ", …" if len(files) > _MAX_LISTED_MEMBERS else ""
    )
    count = f"{len(files)} files: " if len(files) > _MAX_LISTED_MEMBERS else ""
    title = f"a ZIP archive of {count}{listed_names}" if files else "a ZIP archive without files"
    has_one_splat_file = sum(name.lower().endswith(SPLAT_SUFFIXES) for name in files) == 1
    return FileKind(name="zip", title=title, hint=SPLATS if has_one_splat_file else UNPACK)


def _is_hidden(name: str) -> bool:
    return any(part.startswith(".") or part == "__MACOSX" for part in name.split("/"))


def _suffix(name: str) -> str:
    """Return the end of a member's name from its last dot on, in lower case; empty without one."""
    stem, dot, ending = name.rpartition("/")[2].rpartition(".")
    return f"{dot}{ending}".lower() if stem and ending else ""

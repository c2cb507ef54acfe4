"""Finds the splat file that a path names: in a folder, an archive, standard input, at an address.

Known folders are those that training code writes: 3DGS (``point_cloud/iteration_N``), nerfstudio
(``nerfstudio_models``), gsplat (``ply``, ``ckpts``); and those of an unpacked SOG.
"""

__all__ = ["STANDARD_INPUT", "TRAINING_HINT", "TrainingFolder", "resolve_input", "training_folder"]

import gzip
import mmap
import os
import re
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Final, final

from gsgen.contract.file_kinds.kind import UNPACK
from gsgen.contract.file_kinds.names import META_FILE, STREAMED_META
from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, archive_kind, kind_of
from gsgen.formats.codecs import codec_of_suffix, recognise_codec
from gsgen.formats.shared.bytes import MAX_BYTES, MAX_INFLATION
from gsgen.formats.shared.errors import (
    ArchiveDamaged,
    FileUnreadable,
    NotSupported,
    SizeExceeded,
    quoted,
)
from gsgen.formats.shared.files import FileContent, FilePath, naming, open_file, stream_size
from gsgen.formats.shared.npz_arrays import ZIP_MAGIC, unpacking
from gsgen.formats.spz.container import GZIP, is_packed

STANDARD_INPUT: Final = "-"
"""The path that means standard input."""

_CAMERAS_FILE_NAME, _OPTIONS = "cameras.json", "cfg_args"
# Files of splats in the folder of a training; of those that match, the highest number counts.
_TRAINING_LAYOUTS: Final = (
    re.compile(r"point_cloud/iteration_(\d+)/point_cloud\.ply"),
    re.compile(r"iteration_(\d+)/point_cloud\.ply"),
    re.compile(r"nerfstudio_models/step-(\d+)\.ckpt"),
    re.compile(r"step-(\d+)\.ckpt"),
    re.compile(r"ply/point_cloud_(\d+)\.ply"),
    re.compile(r"ckpts/ckpt_(\d+)_rank0\.pt"),
)
# Files and folders that the training code of most methods writes.
_TRAINING_FILES: Final = ("cfg_args", "point_cloud", "point_cloud.ply")
TRAINING_HINT: Final = (
    "`gsgen export METHOD --checkpoint FOLDER -o OUT.onnx` exports the folder of a training; "
    "`gsgen plugins` lists the methods"
)
_SPLAT_KINDS: Final = frozenset(
    ["ply-splats", "compressed-ply", "ply-points", "spz", "glb-splats", "sog", "torch", "npz"]
)

_MAX_NESTING: Final = 2
_MAX_ARCHIVE_MEMBERS: Final = 4096
_READ_CHUNK_BYTES: Final = 1 << 20
_MAX_LISTED_FILES: Final = 4


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingFolder:
    """The folder that the 3DGS training code writes.

    Attributes:
        cloud: The splats of the newest iteration.
        iteration: Its number.
        cameras: The cameras of the training, if their file is there.
        antialiased: Whether the options say that training drew antialiased.
        unused: Files beside the splats that other methods save, such as networks.
    """

    cloud: Path
    iteration: int
    cameras: Path | None
    antialiased: bool
    unused: tuple[str, ...]


def training_folder(path: FilePath) -> TrainingFolder | None:
    """Return the newest iteration in a folder of 3DGS training; None if the path names no such."""
    folder = Path(path)
    if not folder.is_dir():
        return None
    match = _newest_cloud(_file_names(folder))
    if match is None or not match[0].endswith("/point_cloud.ply"):
        return None
    cloud = folder / match[0]
    run = folder if match[0].startswith("point_cloud/") else folder.parent
    options = run / _OPTIONS
    text = options.read_text("utf-8", "replace") if options.is_file() else ""
    neighbour_names = [file.name for file in sorted(cloud.parent.iterdir()) if file != cloud]
    network_files = [
        f"{entry.name}/"
        for entry in sorted(run.iterdir())
        if entry.name != "point_cloud" and entry.is_dir() and any(entry.glob("iteration_*"))
    ]
    return TrainingFolder(
        cloud=cloud,
        iteration=match[1],
        cameras=run / _CAMERAS_FILE_NAME if (run / _CAMERAS_FILE_NAME).is_file() else None,
        antialiased=re.search(r"\bantialiasing=True\b", text) is not None,
        unused=(*network_files, *(name for name in neighbour_names if not name.startswith("."))),
    )


def resolve_input(path: FilePath, *, max_bytes: int = MAX_BYTES) -> FilePath:
    """Return the splat file that a path names.

    An address is that of a file, which is fetched; ``-`` is standard input; a folder stands for its
    newest iteration or its one file of splats; a ZIP archive of another format for its one file of
    splats, and a gzip file for its content. The latter are unpacked in memory.

    Args:
        path: A file, folder, address or ``-``.
        max_bytes: The limit of unpacked bytes.

    Raises:
        FormatError: The path cannot be read, or holds no file of splats, or several.
        InputUnreadable: The file at an address cannot be had.
    """
    address = _address_of(path)
    with naming(address or path):
        file: FilePath = _standard_input() if os.fspath(path) == STANDARD_INPUT else path
        if address:
            file = _fetched_file(address)
        elif Path(path).is_dir():
            file = _find_file_in_folder(Path(path))
        for _ in range(_MAX_NESTING):
            content = _unpack_archive(file, max_bytes)
            if content is None:
                break
            file = content
        return file


@cache
def _standard_input() -> FileContent:
    content = sys.stdin.buffer.read(MAX_BYTES + 1)
    if not content:
        raise FileUnreadable("standard input is empty", expected="the bytes of a file of splats")
    return _content_in_memory("standard input", content)


def _address_of(path: FilePath) -> str:
    if isinstance(path, FileContent) or ":/" not in os.fspath(path):
        return ""
    from gsgen.contract.inputs.addresses import address_of

    return address_of(path)


def _fetched_file(address: str) -> FileContent:
    """Return the file at an address, and those beside it, mapped from copies that are removed."""
    from gsgen.contract.inputs.local_copies import on_disk

    name = address.partition("?")[0]  # the suffix counts
    with on_disk(address) as path:
        neighbours = {
            file.relative_to(path.parent).as_posix(): _mapped(file, name)
            for file in path.parent.rglob("*")
            if file.is_file() and file != path
        }
        return FileContent(name, _mapped(path, name), neighbours)


def _mapped(file: Path, name: str) -> mmap.mmap:
    if not file.stat().st_size:  # which cannot be mapped
        raise FileUnreadable(f"the file {quoted(file.name)} is empty", path=name)
    with file.open("rb") as stream:
        return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


def _content_in_memory(name: str, content: bytes | bytearray) -> FileContent:
    data = mmap.mmap(-1, len(content))
    data[:] = content
    return FileContent(name, data)


def _file_names(folder: Path) -> list[str]:
    """Return the paths of the files of known layouts in a folder, relative to it."""
    patterns = ("*", "*/*", "point_cloud/iteration_*/point_cloud.ply")
    return [
        file.relative_to(folder).as_posix()
        for pattern in patterns
        for file in sorted(folder.glob(pattern))
        if file.is_file()
    ]


def _newest_cloud(names: Sequence[str]) -> tuple[str, int] | None:
    """Return the file of splats with the highest iteration, and this number, of a training."""
    for layout in _TRAINING_LAYOUTS:
        matches = {name: match for name in names if (match := layout.fullmatch(name))}
        if matches:
            name = max(matches, key=lambda entry: int(matches[entry][1]))
            return name, int(matches[name][1])
    return None


def _find_file_in_folder(folder: Path) -> Path:
    names = _file_names(folder)
    newest_cloud = _newest_cloud(names)
    if newest_cloud is not None:
        return folder / newest_cloud[0]
    top_names = [name for name in names if "/" not in name]
    for name in (STREAMED_META, META_FILE, "point_cloud.ply"):
        if name in top_names:
            return folder / name
    splat_names = [name for name in top_names if codec_of_suffix(name) is not None]
    if len(splat_names) == 1:
        return folder / splat_names[0]
    if splat_names:
        raise _several_files_error("folder", splat_names)
    has_training = any((folder / name).exists() for name in _TRAINING_FILES)
    raise FileUnreadable(
        "the path is a folder without a file of splats",
        expected="a file of splats, or a folder that holds one",
        hint=TRAINING_HINT if has_training else "",
    )


def _several_files_error(noun: str, names: Sequence[str]) -> NotSupported:
    listed_files = ", ".join(names[:_MAX_LISTED_FILES]) + (
        ", …" if len(names) > _MAX_LISTED_FILES else ""
    )
    return NotSupported(
        f"the {noun} holds {len(names)} files of splats: {listed_files}",
        expected="one file of splats",
        hint="Name one of them." if noun == "folder" else "Unpack it, and name one of them.",
    )


def _unpack_archive(path: FilePath, max_bytes: int) -> FileContent | None:
    """Return the file of splats in a ZIP archive or gzip file; None if the file is neither."""
    with open_file(path) as file:
        start = file.read(len(ZIP_MAGIC))
        if not (start.startswith(GZIP) or start == ZIP_MAGIC):
            return None
        if start == ZIP_MAGIC:
            return _content_from_zip(path, file, max_bytes)
        return _content_from_gzip(path, file, max_bytes)


def _content_from_gzip(path: FilePath, file: BinaryIO, max_bytes: int) -> FileContent | None:
    file.seek(0)
    if is_packed(file.read(RECOGNITION_BYTES)):
        return None  # SPZ is a gzip file itself
    file.seek(0)
    limit = min(max_bytes, stream_size(file) * MAX_INFLATION)
    with unpacking("gzip stream"), gzip.GzipFile(fileobj=file) as stream:
        head = stream.read(RECOGNITION_BYTES)
        kind = kind_of(head)
        if kind is not None and kind.name == "archive":
            return None  # such as a tar archive, which is named as what it is
        content = bytearray(head)
        while piece := stream.read(_READ_CHUNK_BYTES):
            content += piece
            if len(content) > limit:
                raise _size_error(f"more than {limit}", limit)
    name = os.fspath(path)
    return _content_in_memory(name.removesuffix(".gz") if name.endswith(".gz") else name, content)


def _content_from_zip(path: FilePath, file: BinaryIO, max_bytes: int) -> FileContent | None:
    file.seek(0)
    kind = kind_of(file.read(RECOGNITION_BYTES), file)
    if kind is not None and kind.name == "damaged-zip":
        raise ArchiveDamaged(f"this is {kind.title}", where="archive", hint=kind.hint)
    if recognise_codec(file) is not None:
        return None
    size = stream_size(file)
    with unpacking("archive"), zipfile.ZipFile(file) as archive:
        entries = [entry for entry in archive.infolist() if _is_content(entry)]
        newest_cloud = _newest_cloud(
            [_strip_common_folder(entry.filename, entries) for entry in entries]
        )
        readable = [
            entry
            for entry in entries
            if newest_cloud is None or entry.filename.endswith(newest_cloud[0])
            if newest_cloud is not None or _is_readable(archive, entry)
        ]
        if len(readable) > 1:
            raise _several_files_error("ZIP archive", [entry.filename for entry in readable])
        if not readable:
            kind = archive_kind(archive.namelist())
            hint = UNPACK if kind.name == "zip" else kind.hint
            raise NotSupported(
                f"this is {kind.title}", expected="a file of splats in it", hint=hint
            )
        (entry,) = readable
        limit = min(max_bytes, size * MAX_INFLATION)
        if entry.file_size > limit:
            raise _size_error(str(entry.file_size), limit)
        with archive.open(entry) as stream:
            content = bytearray()
            while piece := stream.read(_READ_CHUNK_BYTES):
                content += piece
                if len(content) > limit:
                    raise _size_error(f"more than {limit}", limit)
    return _content_in_memory(f"{os.fspath(path)}/{entry.filename}", content)


def _is_content(entry: zipfile.ZipInfo) -> bool:
    """Return whether a member of an archive is a file that its author put there."""
    parts = PurePosixPath(entry.filename).parts
    is_hidden_entry = any(part.startswith(".") or part == "__MACOSX" for part in parts)
    return not entry.is_dir() and entry.file_size > 0 and not is_hidden_entry


def _strip_common_folder(name: str, entries: Sequence[zipfile.ZipInfo]) -> str:
    folder = name.partition("/")[0] + "/"
    is_common_folder = all(entry.filename.startswith(folder) for entry in entries)
    known = folder in ("point_cloud/", "ply/", "ckpts/", "nerfstudio_models/")
    return name.removeprefix(folder) if is_common_folder and not known else name


def _is_readable(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bool:
    """Return whether a member of an archive holds splats, by its first bytes and its suffix."""
    with archive.open(entry) as stream:
        head = stream.read(RECOGNITION_BYTES)
    kind = kind_of(head)
    if kind is not None and kind.name in _SPLAT_KINDS:
        return True
    is_unknown = kind is None or kind.name in ("zip", "damaged-zip", "gzip")
    return is_unknown and codec_of_suffix(entry.filename.removesuffix(".gz")) is not None


def _size_error(actual: str, limit: int) -> SizeExceeded:
    return SizeExceeded(
        f"the file in the archive unpacks to {actual} bytes",
        expected=f"{limit} bytes or fewer",
        hint="If you trust the archive, unpack it, and name the file.",
    )

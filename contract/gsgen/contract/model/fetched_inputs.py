"""Returns files on disk for addresses, and for ZIP archives of one model or mesh."""

__all__ = ["ARCHIVE_SUFFIX", "archive_of", "local_file"]

import os
from pathlib import Path
from typing import Final

from gsgen.contract.inputs.addresses import address_of
from gsgen.contract.inputs.remote_file import ByteProgress, ignore_progress

_ARCHIVE_MAGIC: Final = b"PK\x03\x04"
ARCHIVE_SUFFIX: Final = ".zip"
"""The suffix of ZIP archives."""


def local_file(path: str | os.PathLike[str], *, on_bytes: ByteProgress = ignore_progress) -> Path:
    """Return a file on disk for an address or a path, which stays until the process ends.

    The file at an address is copied with the files beside it that it names: external weights of a
    model, textures of a SOG, buffers of a glTF file. A ZIP archive of one model or mesh is
    unpacked, and so is the member of a path such as ``scan.zip/a/scan.ply``. Other paths are
    returned as they are.

    Args:
        path: A path or an address.
        on_bytes: Called with the bytes of a file that have come.

    Raises:
        InputUnreadable: The file cannot be had; the subclass says why.
    """
    address = address_of(path)
    if address:
        from gsgen.contract.inputs.local_copies import fetch, kept_folder

        return fetch(address, kept_folder(), weights_of=_external_weights, on_bytes=on_bytes)
    archive = archive_of(path)
    if archive is not None:
        from gsgen.contract.inputs.archived_file import unpack_member
        from gsgen.contract.inputs.local_copies import kept_folder

        return unpack_member(kept_folder(), archive, Path(path).relative_to(archive).as_posix())
    return _unpacked(Path(path)) or Path(path)


def archive_of(path: str | os.PathLike[str]) -> Path | None:
    """Return the ZIP archive that a path leads into; None for the path of a file or folder."""
    if ARCHIVE_SUFFIX not in os.fspath(path).lower():
        return None
    files = (parent for parent in Path(path).parents if parent.suffix.lower() == ARCHIVE_SUFFIX)
    return next((file for file in files if file.is_file()), None)


def _external_weights(model: Path) -> list[str]:
    """Return the files of external weights that a model names; none of a damaged one."""
    from gsgen.contract.errors import ModelUnreadable
    from gsgen.contract.model.model_file import open_model

    try:
        return list(dict.fromkeys(ref.location for ref in open_model(model).external))
    except ModelUnreadable:  # which is reported when the model is read
        return []


def _unpacked(path: Path) -> Path | None:
    """Unpack an archive of one model or mesh; None for any other file."""
    try:
        if not path.is_file():  # opening a pipe waits for its writer
            return None
        with path.open("rb") as file:
            if file.read(len(_ARCHIVE_MAGIC)) != _ARCHIVE_MAGIC:
                return None
    except (OSError, ValueError):  # the reader of the file reports the cause
        return None
    from gsgen.contract.inputs.archived_file import unpack_into
    from gsgen.contract.inputs.local_copies import kept_folder

    return unpack_into(kept_folder, path)

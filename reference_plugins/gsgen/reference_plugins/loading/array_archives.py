"""Reads arrays from an ``.npz`` archive, and refuses pickled objects in it."""

__all__ = ["read_npz"]

import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.reference_plugins.loading.errors import CheckpointInvalid

# Errors of reading a damaged archive; RuntimeError is for unknown versions and compressions.
_DAMAGE_ERRORS = (
    *(zipfile.BadZipFile, zlib.error, OSError, EOFError),
    *(ValueError, KeyError, TypeError, RuntimeError, MemoryError, OverflowError),
)


def read_npz(path: Path, names: Iterable[str] | None = None, hint: str = "") -> dict[str, Any]:
    """Return the named arrays that an ``.npz`` archive has; other entries are not read."""
    try:
        # NumPy does not close a stream that it opened itself if it fails.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError("the file holds one array, expected an .npz archive")
            requested_names = archive.files if names is None else names
            return {name: archive[name] for name in requested_names if name in archive.files}
    except _DAMAGE_ERRORS as error:
        reason = str(error) or type(error).__name__
        raise CheckpointInvalid(f"cannot be read: {reason}", where=str(path), hint=hint) from error

"""Arrays of an ``.npz``, without those that only a pickle could hold."""

__all__ = ["read_npz"]

import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.reference_plugins.loading.errors import CheckpointInvalid

# What reading a damaged archive raises; RuntimeError has versions and kinds that nobody writes.
_DAMAGED = (
    *(zipfile.BadZipFile, zlib.error, OSError, EOFError),
    *(ValueError, KeyError, TypeError, RuntimeError, MemoryError, OverflowError),
)


def read_npz(
    path: Path, names: Iterable[str] | None = None, hint: str = ""
) -> dict[str, Any]:
    """Return those of ``names`` that the archive has, which may hold anything besides.

    Args:
        path: The file.
        names: Of arrays; all of the archive where absent.
        hint: What is wanted, for the error.

    Raises:
        CheckpointInvalid: It is no archive, damaged, or holds an object under one of the names.
    """
    try:
        # By a stream of our own: numpy leaves its own open where it fails.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError("holds one array, wanted an archive of several")
            wanted = archive.files if names is None else names
            return {name: archive[name] for name in wanted if name in archive.files}
    except _DAMAGED as error:
        reason = str(error) or type(error).__name__
        raise CheckpointInvalid(
            f"cannot be read: {reason}", where=str(path), hint=hint
        ) from error

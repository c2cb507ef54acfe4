"""Reads arrays from ``.npz`` and ``.npy`` files of checkpoints, and refuses pickled objects."""

__all__ = ["read_npy", "read_npz"]

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.process.array_files import ArraysUnreadable, read_array_file, read_arrays
from gsgen.reference_plugins.loading.errors import CheckpointInvalid


def read_npz(path: Path, names: Iterable[str] | None = None, hint: str = "") -> dict[str, Any]:
    """Return the named arrays that an ``.npz`` archive has; other entries are not read."""
    try:
        return dict(read_arrays(path, names))
    except ArraysUnreadable as error:
        raise CheckpointInvalid(error.message, where=str(path), hint=hint) from error


def read_npy(path: Path) -> np.ndarray:
    """Return the array of an ``.npy`` file."""
    try:
        arrays = read_array_file(path)
    except ArraysUnreadable as error:
        raise CheckpointInvalid(error.message, where=str(path)) from error
    if "" not in arrays:
        raise CheckpointInvalid("is an .npz archive, expected an .npy file", where=str(path))
    return arrays[""]

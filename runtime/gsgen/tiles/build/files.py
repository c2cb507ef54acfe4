"""Writes files atomically, so that an existing file marks its task as finished."""

__all__ = ["read_json", "save_array", "sweep", "write_bytes", "write_json"]

import json
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from gsgen.contract.errors import ConfigInvalid, InputUnreadable

PARTIAL_SUFFIX: Final = ".part"


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file atomically: under a temporary name, then renamed."""
    _write(path, lambda file: file.write(data))


def save_array(path: Path, array: np.ndarray) -> None:
    """Write a NumPy array to a ``.npy`` file atomically."""
    _write(path, lambda file: np.save(file, array, allow_pickle=False))


def write_json(path: Path, content: object) -> None:
    """Write a JSON file with sorted keys, atomically."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    write_bytes(path, text.encode())


def _write(path: Path, write: Callable[[BinaryIO], object]) -> None:
    # Several workers may write one content-addressed file at once, so names are random.
    partial_path = path.parent / f".{path.name}.{secrets.token_hex(4)}{PARTIAL_SUFFIX}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with open(partial_path, "xb") as file:
                write(file)
            os.replace(partial_path, path)
        finally:
            partial_path.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigInvalid(
            f"cannot be written: {error.strerror or error}", where=str(path)
        ) from error


def read_json(path: Path) -> Any:
    """Return the JSON value in a file."""
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise InputUnreadable(message, where=str(path)) from error
    except ValueError as error:
        raise InputUnreadable(
            f"is not JSON: {error}", where=str(path), hint="Start again with --fresh."
        ) from error


def sweep(folder: Path) -> int:
    """Delete the temporary files of killed workers; return their number."""
    parts = list(folder.rglob(f".*{PARTIAL_SUFFIX}"))
    for partial_path in parts:
        partial_path.unlink(missing_ok=True)
    return len(parts)

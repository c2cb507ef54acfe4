"""Writes files atomically, so that an existing file marks its task as finished."""

__all__ = ["read_json", "save_array", "sweep", "write_bytes", "write_json"]

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.process.atomic_files import write_fault
from gsgen.contract.process.drafts import sweep_drafts, temporary_folder


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
    # Several workers may write one content-addressed file at once: each has its own folder.
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(path.parent) as folder:
            draft = folder / "draft"
            with open(draft, "xb") as file:
                write(file)
            os.replace(draft, path)
    except OSError as error:
        raise ConfigInvalid(f"cannot be written: {write_fault(error)}", where=str(path)) from error


def read_json(path: Path, hint: str = "Start again with --fresh.") -> Any:
    """Return the JSON value in a file; ``hint`` is what to do if it is damaged."""
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise InputUnreadable(message, where=str(path)) from error
    except ValueError as error:
        raise InputUnreadable(f"is not JSON: {error}", where=str(path), hint=hint) from error


def sweep(folder: Path) -> int:
    """Remove the temporary folders of killed workers at any depth; return their number."""
    return sum(sweep_drafts(Path(subfolder)) for subfolder, _, _ in os.walk(folder))

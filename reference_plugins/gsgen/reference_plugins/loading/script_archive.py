"""Reads the tensors of a TorchScript archive (``torch.jit.save``) without running code in it.

The training code of Scaffold-GS saves its networks as TorchScript, whose code can do anything. The
archive also holds a pickle of the modules' attributes, from which the tensors are read by their
names in ``state_dict``.
"""

__all__ = ["is_script_archive", "read_script_state"]

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gsgen.formats.checkpoints.pickled_data import Opaque, TensorReference
from gsgen.formats.checkpoints.torch_archive import TorchArchive
from gsgen.formats.shared.errors import FormatError
from gsgen.formats.shared.npz_arrays import unpacking
from gsgen.reference_plugins.loading.errors import CheckpointInvalid


def is_script_archive(path: Path) -> bool:
    """Return whether ``torch.jit.save``, and not ``torch.save``, wrote a file.

    True for an archive too damaged to be listed: :func:`read_script_state` then refuses it.
    """
    try:
        if not zipfile.is_zipfile(path):
            return False
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith("/constants.pkl") for name in archive.namelist())
    except (zipfile.BadZipFile, ValueError, RuntimeError, OSError):
        return True


def read_script_state(path: Path) -> dict[str, Tensor]:
    """Return the parameters and buffers of a TorchScript archive by dotted name, as float32.

    The archive may refer to tensors and modules only.
    """
    try:
        with unpacking("TorchScript"), zipfile.ZipFile(path) as file:
            archive = TorchArchive(file, path.stat().st_size)
            return {
                name: torch.from_numpy(archive.array(tensor, name))
                for name, tensor in _tensors(archive.data(), "", set())
            }
    except FormatError as error:
        hint = "Expected a network saved by torch.jit.save, as the training code writes it."
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path), hint=hint) from error


def _tensors(value: Any, prefix: str, seen: set[int]) -> Iterator[tuple[str, TensorReference]]:
    """Yield the tensors of a module and of the modules in it, by their dotted names."""
    if isinstance(value, TensorReference):
        yield prefix, value
    elif isinstance(value, Opaque):
        if not value.name.startswith("__torch__."):
            raise ValueError(f"the pickle refers to {value.name}, which is not a tensor")
        if id(value) in seen:  # modules that share modules may have more names than can be listed
            raise ValueError("a module of the pickle is part of two others, expected a tree")
        seen.add(id(value))
        for name, child in value.state.items():
            yield from _tensors(child, f"{prefix}.{name}" if prefix else str(name), seen)

"""Reads and writes safetensors files with the library of the same name.

Such a file cannot hold code: https://github.com/huggingface/safetensors#format. The library refuses
headers above 100 MB, and tensors that overlap, leave gaps or exceed the file.
"""

__all__ = ["is_safetensors", "read_metadata", "read_safetensors", "write_safetensors"]

from collections.abc import Mapping
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file

_LENGTH_BYTES = 8


def read_safetensors(path: Path) -> dict[str, Tensor]:
    """Read every tensor of a safetensors file."""
    required_file(path, "the weights")
    try:
        # Copies: mapped tensors may be unaligned, and kernels then round differently.
        return {name: value.clone() for name, value in load_file(path).items()}
    except (OSError, SafetensorError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error


def is_safetensors(path: Path) -> bool:
    """Return whether a file has the suffix or the first bytes of safetensors."""
    if path.suffix == ".safetensors":
        return True
    with path.open("rb") as stream:
        return stream.read(_LENGTH_BYTES + 1)[_LENGTH_BYTES:] == b"{"


def read_metadata(path: Path) -> dict[str, str]:
    """Read the metadata of a safetensors file: texts by name."""
    required_file(path, "the weights")
    try:
        with safe_open(path, "pt") as file:
            return dict(file.metadata() or {})
    except (OSError, SafetensorError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error


def write_safetensors(
    path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str] | None = None
) -> None:
    """Write tensors to a safetensors file."""
    # Copies: the library refuses tensors that share memory.
    cpu_tensors = {
        name: value.detach().cpu().clone().contiguous() for name, value in tensors.items()
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(save(cpu_tensors, {"format": "pt", **(metadata or {})}))

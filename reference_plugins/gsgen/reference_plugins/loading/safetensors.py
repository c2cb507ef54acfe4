"""Reads and writes tensors in the safetensors format: a JSON header, then the raw bytes.

Layout: https://github.com/huggingface/safetensors#format. Such a file cannot hold code.
"""

__all__ = ["is_safetensors", "read_metadata", "read_safetensors", "write_safetensors"]

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file

_LENGTH = 8
_MAX_HEADER_BYTES = 100_000_000
_METADATA = "__metadata__"
_DTYPES = {
    "F64": torch.float64, "F32": torch.float32, "F16": torch.float16, "BF16": torch.bfloat16,
    "I64": torch.int64, "I32": torch.int32, "I16": torch.int16, "I8": torch.int8, "U8": torch.uint8,
    "BOOL": torch.bool,
}  # fmt: skip
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


def read_safetensors(path: Path) -> dict[str, Tensor]:
    """Read every tensor of a safetensors file."""
    required_file(path, "the weights")
    try:
        data = bytearray(path.read_bytes())
        return _tensors(data)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}" if isinstance(error, KeyError) else error
        raise CheckpointInvalid(f"cannot be read: {reason}", where=str(path)) from error


def is_safetensors(path: Path) -> bool:
    """Return whether a file has the suffix or the first bytes of safetensors."""
    if path.suffix == ".safetensors":
        return True
    with path.open("rb") as stream:
        return stream.read(_LENGTH + 1)[_LENGTH:] == b"{"


def read_metadata(path: Path) -> dict[str, str]:
    """Read the metadata of a safetensors file: texts by name."""
    required_file(path, "the weights")
    try:
        with path.open("rb") as stream:
            start = stream.read(_LENGTH + _MAX_HEADER_BYTES)
        header, _ = _header(start, path.stat().st_size)
        metadata = header.get(_METADATA, {})
        return {str(name): str(value) for name, value in metadata.items()}
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path)) from error


def _header(data: bytes | bytearray, size: int) -> tuple[dict[str, Any], int]:
    """Parse the header from the first bytes of a safetensors file; return it and its end offset."""
    length = int.from_bytes(data[:_LENGTH], "little")
    if size < _LENGTH or length > min(_MAX_HEADER_BYTES, size - _LENGTH):
        raise ValueError(f"the header length is {length:,} bytes, but the file has {size:,}")
    header = json.loads(data[_LENGTH : _LENGTH + length].decode("utf-8"))
    if not isinstance(header, dict):
        raise ValueError(f"the header is a {type(header).__name__}, expected a JSON object")
    return header, _LENGTH + length


def _tensors(data: bytearray) -> dict[str, Tensor]:
    header, start = _header(data, len(data))
    return {
        name: _tensor(data, start, name, entry)
        for name, entry in header.items()
        if name != _METADATA
    }


def _tensor(data: bytearray, start: int, name: str, entry: Any) -> Tensor:
    if entry["dtype"] not in _DTYPES:
        message = (
            f"tensor {name} has the dtype {entry['dtype']}; expected one of {', '.join(_DTYPES)}"
        )
        raise ValueError(message)
    dtype, shape = _DTYPES[entry["dtype"]], [int(size) for size in entry["shape"]]
    begin, end = (int(offset) for offset in entry["data_offsets"])
    count = math.prod(shape)
    inside = 0 <= begin <= end <= len(data) - start
    if not inside or min(shape, default=0) < 0 or end - begin != count * dtype.itemsize:
        raise ValueError(f"tensor {name} {shape} does not fit bytes {begin:,} to {end:,}")
    if not count:
        return torch.empty(shape, dtype=dtype)
    # A copy, because numbers in the file may be unaligned.
    part = data[start + begin : start + end]
    return torch.frombuffer(part, dtype=dtype).reshape(shape)


def write_safetensors(
    path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str] | None = None
) -> None:
    """Write tensors to a safetensors file, sorted by name."""
    header: dict[str, Any] = {_METADATA: {"format": "pt", **(metadata or {})}}
    parts, offset = [], 0
    for name in sorted(tensors):
        value = tensors[name].detach().cpu().contiguous()
        part = bytes(value.flatten().view(torch.uint8).numpy()) if value.numel() else b""
        header[name] = {
            "dtype": _NAMES[value.dtype],
            "shape": list(value.shape),
            "data_offsets": [offset, offset + len(part)],
        }
        parts.append(part)
        offset += len(part)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % _LENGTH)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(len(text).to_bytes(_LENGTH, "little") + text + b"".join(parts))

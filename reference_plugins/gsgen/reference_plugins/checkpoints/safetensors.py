"""Files of tensors in the safetensors format: a header of JSON, and bytes behind it.

Layout: https://github.com/huggingface/safetensors#format. Nothing in such a file can be run.
"""

__all__ = ["read_safetensors", "write_safetensors"]

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid
from gsgen.reference_plugins.checkpoints.folder import required_file

_LENGTH = 8
_MOST_HEADER = 100_000_000
_DTYPES = {
    "F64": torch.float64,
    "F32": torch.float32,
    "F16": torch.float16,
    "BF16": torch.bfloat16,
    "I64": torch.int64,
    "I32": torch.int32,
    "I16": torch.int16,
    "I8": torch.int8,
    "U8": torch.uint8,
    "BOOL": torch.bool,
}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


def read_safetensors(path: Path) -> dict[str, Tensor]:
    """Read every tensor of a file.

    Raises:
        CheckpointInvalid: It is missing, damaged, or holds a dtype that torch does not have.
    """
    required_file(path, "the weights")
    try:
        data = bytearray(path.read_bytes())
        return _tensors(data)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = (
            f"{type(error).__name__}: {error}" if isinstance(error, KeyError) else error
        )
        raise CheckpointInvalid(f"cannot be read: {reason}", where=str(path)) from error


def _tensors(data: bytearray) -> dict[str, Tensor]:
    length = int.from_bytes(data[:_LENGTH], "little")
    if len(data) < _LENGTH or length > min(_MOST_HEADER, len(data) - _LENGTH):
        raise ValueError(f"the header is said to have {length:,} of {len(data):,} bytes")
    header = json.loads(data[_LENGTH : _LENGTH + length].decode("utf-8"))
    if not isinstance(header, dict):
        raise ValueError("the header is no object")
    return {
        name: _tensor(data, _LENGTH + length, name, entry)
        for name, entry in header.items()
        if name != "__metadata__"
    }


def _tensor(data: bytearray, start: int, name: str, entry: Any) -> Tensor:
    if entry["dtype"] not in _DTYPES:
        raise ValueError(
            f"{name} has the dtype {entry['dtype']}; known: {', '.join(_DTYPES)}"
        )
    dtype, shape = _DTYPES[entry["dtype"]], [int(size) for size in entry["shape"]]
    begin, end = (int(offset) for offset in entry["data_offsets"])
    count = math.prod(shape)
    inside = 0 <= begin <= end <= len(data) - start
    if not inside or min(shape, default=0) < 0 or end - begin != count * dtype.itemsize:
        raise ValueError(f"{name} {shape} does not fit bytes {begin:,} to {end:,}")
    if not count:
        return torch.empty(shape, dtype=dtype)
    # A copy, as numbers in the file need not be aligned.
    part = data[start + begin : start + end]
    return torch.frombuffer(part, dtype=dtype).reshape(shape)


def write_safetensors(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Write tensors one after the other, in the order of their names."""
    header: dict[str, Any] = {"__metadata__": {"format": "pt"}}
    parts, at = [], 0
    for name in sorted(tensors):
        value = tensors[name].detach().cpu().contiguous()
        part = bytes(value.flatten().view(torch.uint8).numpy()) if value.numel() else b""
        header[name] = {
            "dtype": _NAMES[value.dtype],
            "shape": list(value.shape),
            "data_offsets": [at, at + len(part)],
        }
        parts.append(part)
        at += len(part)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % _LENGTH)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(len(text).to_bytes(_LENGTH, "little") + text + b"".join(parts))

"""Reads the tensors of a TorchScript archive without loading its program.

``torch.jit.load`` compiles code that is in the file. The weights alone are a pickle (``data.pkl``)
and one raw file for each storage, inside an uncompressed zip. A pickle reader that knows only
tensors finds them, by their names in ``state_dict``.
"""

__all__ = ["is_script_archive", "read_script_state"]

import pickle
import sys
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, final

import torch
from torch import Tensor

from gsgen.reference_plugins.loading.errors import CheckpointInvalid

_DTYPES = {
    "FloatStorage": torch.float32, "DoubleStorage": torch.float64, "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16, "LongStorage": torch.int64, "IntStorage": torch.int32,
    "ShortStorage": torch.int16, "CharStorage": torch.int8, "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}  # fmt: skip


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
    """Return the parameters and buffers of a TorchScript archive by dotted name.

    The archive may refer to tensors and modules only.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return dict(_tensors(_Reader(archive).module(), ""))
    except (zipfile.BadZipFile, pickle.UnpicklingError, KeyError, OSError) as error:
        raise _damaged(path, error) from error
    except (ValueError, TypeError, RuntimeError, EOFError, AttributeError) as error:
        raise _damaged(path, error) from error  # errors of a pickle with wrong arguments


def _damaged(path: Path, error: Exception) -> CheckpointInvalid:
    reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
    hint = "Expected a network saved by torch.jit.save, as the training code writes it."
    return CheckpointInvalid(f"cannot be read: {reason}", where=str(path), hint=hint)


@final
class _Module:
    """Placeholder for any TorchScript class: keeps the attributes and runs no code."""

    def __init__(self) -> None:
        self.attributes: dict[str, Any] = {}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.attributes = state


@final
class _Storage:
    """Placeholder that names the dtype of a tensor storage; it is never called."""

    def __init__(self, dtype: torch.dtype) -> None:
        self.dtype = dtype


@final
class _Reader:
    """Reads the pickle of one TorchScript archive without running code."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
        if len(names) != 1:
            raise ValueError(f"the archive has {len(names)} entries named data.pkl, expected one")
        self._root = names[0].removesuffix("data.pkl")
        order = f"{self._root}byteorder"
        if order in archive.namelist() and self._bytes("byteorder") != sys.byteorder.encode():
            message = f"has another byte order than this machine, expected {sys.byteorder}-endian"
            raise ValueError(message)

    def module(self) -> Any:
        with self._archive.open(f"{self._root}data.pkl") as file:
            return _Unpickler(file, self.storage).load()

    def storage(self, key: str, dtype: torch.dtype) -> Tensor:
        return torch.frombuffer(bytearray(self._bytes(f"data/{key}")), dtype=dtype)

    def _bytes(self, name: str) -> bytes:
        info = self._archive.getinfo(self._root + name)
        if info.compress_type != zipfile.ZIP_STORED:
            raise ValueError(f"the entry {info.filename} is compressed, expected it uncompressed")
        return self._archive.read(info)


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: Any, storage: Callable[[str, torch.dtype], Tensor]) -> None:
        super().__init__(file)
        self._storage = storage

    def find_class(self, module: str, name: str) -> Any:
        if module == "__torch__" or module.startswith("__torch__."):
            return _Module
        if module == "torch" and name in _DTYPES:
            return _Storage(_DTYPES[name])
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _rebuilt
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        raise pickle.UnpicklingError(f"the pickle refers to {module}.{name}, which is not a tensor")

    def persistent_load(self, pid: Any) -> Tensor:
        _, kind, key, *_ = pid
        return self._storage(str(key), kind.dtype)


def _rebuilt(
    storage: Tensor, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> Tensor:
    if not size or 0 in size:
        return storage[offset : offset + 1].reshape(size) if not size else storage.new_empty(size)
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if offset < 0 or min(stride) < 0 or last >= len(storage):
        raise ValueError(f"a tensor {list(size)} does not fit its {len(storage)} stored numbers")
    return storage.as_strided(size, stride, offset).clone()


def _tensors(value: Any, prefix: str) -> Iterator[tuple[str, Tensor]]:
    if isinstance(value, Tensor):
        yield prefix, value
    elif isinstance(value, _Module):
        for name, child in value.attributes.items():
            yield from _tensors(child, f"{prefix}.{name}" if prefix else str(name))

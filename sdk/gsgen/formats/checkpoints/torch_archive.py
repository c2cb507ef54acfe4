"""Reads tensors from a ``torch.save`` file (zip archive, torch 1.6 and later) with NumPy."""

__all__ = ["PICKLE_MEMBER", "TorchArchive"]

import math
import zipfile
from typing import Any, Final, final

import numpy as np
from jaxtyping import Float

from gsgen.formats.checkpoints.pickled_data import TensorReference, pickled_data
from gsgen.formats.shared.errors import ArchiveDamaged, NotSupported, SizeExceeded, ValueInvalid
from gsgen.formats.shared.npz_arrays import unpacking

PICKLE_MEMBER: Final = "*/data.pkl"
"""The member of the archive that names the tensors; its folder has the name of the file."""

_MAX_READS_PER_BYTE = 64
"""How often the bytes of the file may be read, because tensors take turns in several storages."""

_MAX_PICKLE_BYTES = 16 << 20
"""The most bytes of names and settings; checkpoints of splats have a few thousand."""


@final
class TorchArchive:
    """An open ``torch.save`` archive, whose tensors are read on demand."""

    def __init__(self, archive: zipfile.ZipFile, file_size: int) -> None:
        self._archive, self._file_size = archive, file_size
        self._number_count = self._byte_count = 0  # of all tensors and storages that were read
        self._storage_key, self._storage = "", b""  # the last one
        with unpacking("archive"):
            names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
            if len(names) != 1:
                raise ValueError(f"the zip archive has {len(names)} files data.pkl, expected one")
            self._member_prefix = names[0].removesuffix("data.pkl")
            self.is_script = f"{self._member_prefix}constants.pkl" in archive.namelist()
            has_byte_order_member = f"{self._member_prefix}byteorder" in archive.namelist()
            self._order = (
                ">" if has_byte_order_member and self._read_member("byteorder") == b"big" else "<"
            )

    def data(self) -> Any:
        """Return the saved Python object, with a :class:`TensorReference` for each tensor."""
        with unpacking("data.pkl"):
            return pickled_data(self._read_member("data.pkl", _MAX_PICKLE_BYTES))

    def array(
        self, tensor: TensorReference, name: str, *, keep_doubles: bool = False
    ) -> Float[np.ndarray, "..."]:
        """Read a floating-point tensor of the archive as float32.

        With ``keep_doubles``, a tensor of float64 stays float64.

        Raises:
            ArchiveDamaged: The numbers are missing, or fewer than the shape needs.
            SizeExceeded: All tensors together have more numbers than the file has bytes.
            ValueInvalid: The tensor does not hold floats.
        """
        dtype = tensor.storage.dtype
        if "float" not in dtype:
            raise ValueInvalid(
                "the tensor holds no floats", where=name, expected="a tensor of floats"
            )
        with unpacking(name):
            content = self._stored_bytes(tensor.storage.key)
            stored_type = "u2" if dtype == "bfloat16" else np.dtype(dtype).str[1:]
            numbers = np.frombuffer(content, f"{self._order}{stored_type}")
            strided_array = _strided_view(numbers, tensor, name)
            self._count_numbers(strided_array.size, name)
            if dtype == "bfloat16":  # the upper half of a float32
                return (strided_array.astype(np.uint32) << 16).view(np.float32)
            if keep_doubles and dtype == "float64":
                return strided_array.astype(np.float64, order="C")
            # A double beyond float32 becomes infinite, which the check of values refuses.
            with np.errstate(over="ignore", invalid="ignore"):
                return strided_array.astype(np.float32, order="C")

    def _count_numbers(self, numbers: int, name: str) -> None:
        self._number_count += numbers
        if self._number_count > self._file_size:
            raise SizeExceeded(
                f"the tensors have {self._number_count} numbers together",
                where=name,
                expected=f"{self._file_size} or fewer, the bytes of the file",
            )

    def _stored_bytes(self, key: str) -> bytes:
        """Read the bytes of a storage, which the next tensor often shares."""
        if key != self._storage_key:
            content = self._read_member(f"data/{key}")
            self._byte_count += len(content)
            if self._byte_count > _MAX_READS_PER_BYTE * self._file_size:
                raise SizeExceeded(
                    f"the tensors take turns in storages, of which {self._byte_count} bytes were read",
                    where=f"data/{key}",
                    expected=f"{_MAX_READS_PER_BYTE} times the file or fewer",
                )
            self._storage_key, self._storage = key, content
        return self._storage

    def _read_member(self, name: str, limit: int | None = None) -> bytes:
        """Read a file of the zip archive, after a check of its declared size."""
        entry = self._archive.getinfo(self._member_prefix + name)
        if entry.compress_type != zipfile.ZIP_STORED or entry.compress_size != entry.file_size:
            raise NotSupported(
                "the file in the archive is compressed",
                where=name,
                expected="an archive as torch.save writes it",
            )
        most = self._file_size if limit is None else min(limit, self._file_size)
        if entry.file_size > most:
            raise SizeExceeded(
                f"the file in the archive has {entry.file_size} bytes",
                where=name,
                expected=f"{most} bytes or fewer",
            )
        return self._archive.read(entry)


def _strided_view(numbers: np.ndarray, tensor: TensorReference, name: str) -> np.ndarray:
    shape, strides = tensor.shape, tensor.strides
    if len(shape) != len(strides):
        raise ValueError(
            f"the tensor has {len(shape)} dimensions, but {len(strides)} strides: expected one "
            "stride for each dimension"
        )
    if 0 in shape:
        # A hostile shape may have any other size beside the 0.
        if max(shape) > 1 << 40:
            raise ValueError(
                f"the tensor has a dimension of {max(shape)}, expected at most {1 << 40}"
            )
        return np.empty(shape, numbers.dtype)
    last = tensor.offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
    # Strides of 0 would make a small file a large array.
    if last >= len(numbers) or math.prod(shape) > len(numbers):
        raise ArchiveDamaged(
            f"the tensor has shape {list(shape)}, but {len(numbers)} stored numbers",
            where=name,
            expected="numbers for the whole tensor",
            hint="copy, download or save the file again",
        )
    return np.lib.stride_tricks.as_strided(
        numbers[tensor.offset :],
        shape,
        [step * numbers.itemsize for step in strides],
        writeable=False,
    )

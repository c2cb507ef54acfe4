"""Reads NumPy arrays from a pickle, from the bytes that it stores: nothing that it names is built.

The body models of SMPL are pickles of Python 2: a dict of NumPy arrays, a sparse matrix of SciPy
and, in the oldest files, arrays wrapped by chumpy.
"""

__all__ = ["read_array_pickle"]

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from jaxtyping import Shaped

from gsgen.contract.process.array_files import read_array_header
from gsgen.formats.checkpoints.pickled_data import OpaqueObject, pickled_data
from gsgen.reference_plugins.loading.errors import CheckpointInvalid

_RECONSTRUCT_NAMES, _SCALAR_NAMES, _FROM_BUFFER_NAMES = (
    tuple(f"numpy.{core_name}.{name}" for core_name in ("core", "_core"))
    for name in ("multiarray._reconstruct", "multiarray.scalar", "numeric._frombuffer")
)
_OLD_OBJECTS: Final = ("copy_reg._reconstructor", "copyreg._reconstructor")
_DTYPE_PATTERN: Final = re.compile(r"b1|[iu][1248]|f[248]")
_MAX_NUMBERS: Final = 1 << 24
"""The most numbers in sparse matrices, their zeros included, and in selections; SMPL-X has 13 M."""

_Array = Shaped[np.ndarray, "..."]


def read_array_pickle(path: Path, names: Iterable[str]) -> dict[str, _Array]:
    """Return the named arrays of a pickled dict, those of SciPy and chumpy as NumPy arrays.

    An ``.npy`` file may hold the dict as ``np.save`` writes it: one object in an array without
    axes.
    """
    try:
        with path.open("rb") as file:
            if path.suffix == ".npy" and not _contains_python_object(file):
                raise ValueError("the .npy file holds an array, expected a dict of arrays")
            read = pickled_data(file.read())
        if (
            isinstance(read, OpaqueObject)
            and read.name in _RECONSTRUCT_NAMES
            and read.state[1] == ()
        ):
            (read,) = read.state[-1]
        decoder = _Decoder()
        if not isinstance(read, dict):
            kind = decoder.array(read).dtype
            raise ValueError(f"the pickle holds {kind}, expected a dict of arrays")
        return {name: decoder.array(read[name]) for name in names if name in read}
    except (ValueError, TypeError, LookupError, EOFError, AttributeError) as error:
        raise _unreadable_pickle_error(path, str(error) or type(error).__name__) from error
    except (MemoryError, OverflowError, RecursionError) as error:
        raise _unreadable_pickle_error(path, type(error).__name__) from error


def _contains_python_object(file: Any) -> bool:
    """Read the header of an ``.npy`` file, and return whether a pickle follows."""
    _, dtype = read_array_header(file)
    return bool(dtype.hasobject)


def _unreadable_pickle_error(path: Path, reason: str) -> CheckpointInvalid:
    hint = "Expected a pickle of arrays; code in files is not run."
    return CheckpointInvalid(f"cannot be read: {reason[:200]}", where=str(path), hint=hint)


@final
class _Decoder:
    """Decodes records of a pickle to arrays, each record once."""

    def __init__(self) -> None:
        self._decoded_arrays: dict[int, _Array] = {}
        self._number_count = 0

    def array(self, value: Any) -> _Array:
        """Return the array that a value of a pickle stands for."""
        if isinstance(value, OpaqueObject):
            if id(value) not in self._decoded_arrays:
                self._decoded_arrays[id(value)] = self._decode_array(value)
            return self._decoded_arrays[id(value)]
        # NumPy would multiply what nested lists share.
        if isinstance(value, list | tuple) and any(isinstance(n, list | tuple) for n in value):
            raise ValueError("the pickle holds a list of lists, expected an array")
        return np.asarray(value)

    def _decode_array(self, record: OpaqueObject) -> _Array:
        name, arguments, state = record.name, record.arguments, record.state
        if name in _RECONSTRUCT_NAMES and arguments[0].name == "numpy.ndarray":
            _, shape, dtype, is_column_major, data = state
            return self._decode_stored(data, dtype, shape, "F" if is_column_major else "C")
        if name in _SCALAR_NAMES:
            dtype, data = arguments
            return self._decode_stored(data, dtype, (), "C")
        if name in _FROM_BUFFER_NAMES:
            data, dtype, shape, order = arguments
            return self._decode_stored(data, dtype, shape, "F" if order == "F" else "C")
        kind = arguments[0].name if name in _OLD_OBJECTS else name
        if re.fullmatch(r"scipy\.sparse\..*\bcs[cr]_(matrix|array)", kind):
            return self._decode_sparse(state, is_column_major="csc_" in kind)
        if kind == "chumpy.reordering.Select":
            return self._decode_selection(state)
        if kind.startswith("chumpy."):  # an array as it is, under the name x
            if "x" not in state:
                raise ValueError("a pickled array of chumpy has no attribute x")
            return self.array(state["x"])
        raise ValueError(f"the pickle names {kind}, which is not an array")

    def _decode_stored(self, data: Any, dtype: Any, shape: tuple[int, ...], order: Any) -> _Array:
        """Return an array of stored bytes, whose number has to be that of dtype and shape."""
        code = dtype.arguments[0]
        if code.startswith("O"):
            for item in data if isinstance(data, list) else ():
                self.array(item)
            raise ValueError("an array in the pickle holds objects, expected numbers")
        if dtype.name != "numpy.dtype" or not _DTYPE_PATTERN.fullmatch(code):
            raise ValueError(f"an array in the pickle has the dtype {code!r:.20}, expected numbers")
        if any(type(size) is not int or size < 0 for size in shape):
            raise ValueError("an array in the pickle has a size that is not a whole number")
        big_endian = isinstance(dtype.state, tuple) and dtype.state[1] == ">"
        kind = np.dtype(code).newbyteorder(">" if big_endian else "<")
        content = _bytes_of_pickled_data(data)
        if len(content) != math.prod(shape) * kind.itemsize:
            raise ValueError(
                f"an array in the pickle is {list(shape)} of {code}, but has {len(content)} bytes"
            )
        return np.ndarray(shape, kind, buffer=content, order=order)

    def _decode_sparse(self, state: dict[str, Any], *, is_column_major: bool) -> _Array:
        """Return a sparse matrix of SciPy, compressed by columns or by rows, with its zeros."""
        rows, columns = map(int, state["_shape" if "_shape" in state else "shape"])
        row_starts, minor_indices, data = (
            self.array(state[name]) for name in ("indptr", "indices", "data")
        )
        major_count = columns if is_column_major else rows
        counts = np.diff(row_starts)
        has_fitting_shape = row_starts.shape == (
            major_count + 1,
        ) and minor_indices.shape == data.shape == (counts.sum(),)
        if not has_fitting_shape or row_starts[0] != 0 or (counts < 0).any():
            raise ValueError(f"a sparse matrix does not fit its shape {rows} × {columns}")
        self._count_numbers(rows * columns)
        array = np.zeros((rows, columns), data.dtype)
        major_index = np.repeat(np.arange(major_count), counts)
        index = (minor_indices, major_index) if is_column_major else (major_index, minor_indices)
        np.add.at(array, index, data)  # entries of equal index add up
        return array

    def _decode_selection(self, state: dict[str, Any]) -> _Array:
        """Return selected entries of another array of chumpy, such as the first ten shapes."""
        source, index = self.array(state["a"]).ravel(), self.array(state["idxs"])
        self._count_numbers(source.size + index.size)  # both may be copied
        entries: _Array = source[index]
        return np.reshape(entries, state.get("preferred_shape", entries.shape))

    def _count_numbers(self, numbers: int) -> None:
        self._number_count += numbers
        if self._number_count > _MAX_NUMBERS:
            raise ValueError(
                f"the pickle describes arrays of {self._number_count:,} numbers, "
                f"expected at most {_MAX_NUMBERS:,}"
            )


def _bytes_of_pickled_data(data: Any) -> bytes | bytearray:
    """Return stored bytes; Python 2 has them as a text, protocol 2 of Python 3 as an encoded one."""
    if isinstance(data, OpaqueObject) and data.name == "_codecs.encode":
        data, _ = data.arguments
    elif isinstance(data, OpaqueObject) and data.name == "__builtin__.bytes":
        data = b"".join(data.arguments)  # it has none: the array is empty
    if isinstance(data, str):
        return data.encode("latin1")
    if not isinstance(data, bytes | bytearray):
        raise ValueError(f"an array in the pickle has a {type(data).__name__} for its bytes")
    return data

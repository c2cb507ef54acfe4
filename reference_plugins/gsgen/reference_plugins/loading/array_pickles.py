"""Reads NumPy arrays from a pickle without calling any function that the file names.

The body models of SMPL are pickles of Python 2: a dict of NumPy arrays, a sparse matrix of SciPy
and, in the oldest files, arrays wrapped by chumpy. A pickle can call any function by name; this
reader knows those of arrays and refuses all others.
"""

__all__ = ["read_array_pickle"]

import pickle
from pathlib import Path
from typing import Any, BinaryIO, final

import numpy as np
from numpy._core.multiarray import _reconstruct

from gsgen.reference_plugins.loading.errors import CheckpointInvalid


def read_array_pickle(path: Path) -> dict[str, Any]:
    """Return the pickled dict of a file, with sparse and chumpy arrays as NumPy arrays.

    An ``.npy`` file may hold the dict as ``np.save`` writes it: one object in an array without
    axes.
    """
    try:
        with path.open("rb") as file:
            if path.suffix == ".npy":
                _pass_header(file)
            read = _Unpickler(file, encoding="latin1").load()
        if isinstance(read, np.ndarray) and read.shape == () and read.dtype == object:
            read = read.item()
        if not isinstance(read, dict):
            raise ValueError(f"the pickle holds a {type(read).__name__}, expected a dict of arrays")
        return {str(name): _plain(value) for name, value in read.items()}
    except pickle.UnpicklingError as error:
        raise _unreadable(path, str(error)) from error
    except (ValueError, TypeError, KeyError, IndexError, EOFError, AttributeError) as error:
        raise _unreadable(path, str(error) or type(error).__name__) from error
    except (MemoryError, OverflowError, UnicodeError, RecursionError) as error:
        raise _unreadable(path, type(error).__name__) from error


def _pass_header(file: BinaryIO) -> None:
    """Move to the start of the pickle in an ``.npy`` file."""
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        header = np.lib.format.read_array_header_2_0
    if not header(file)[2].hasobject:
        raise ValueError("the .npy file holds an array, expected a dict of arrays")


def _unreadable(path: Path, reason: str) -> CheckpointInvalid:
    hint = "Expected a pickle of arrays; code in files is not run."
    return CheckpointInvalid(f"cannot be read: {reason[:200]}", where=str(path), hint=hint)


class _Inert:
    """Placeholder for a class that a pickle names: keeps the object's state and runs no code."""

    def __init__(self, *_: Any) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, dict) else {}


@final
class _Sparse(_Inert):
    """A sparse matrix of SciPy, compressed by columns or by rows."""

    by_columns = True

    def dense(self) -> np.ndarray:
        shape: Any = self.state.get("_shape", self.state.get("shape"))
        starts, minor, data = (self.state[k] for k in ("indptr", "indices", "data"))
        rows, columns = (int(size) for size in shape)
        major = columns if self.by_columns else rows
        if len(starts) != major + 1 or len(minor) != len(data):
            raise ValueError(f"a sparse matrix does not fit its shape {rows} × {columns}")
        array = np.zeros((rows, columns), np.asarray(data).dtype)
        major_index = np.repeat(np.arange(major), np.diff(starts))
        index = (minor, major_index) if self.by_columns else (major_index, minor)
        np.add.at(array, index, data)  # entries of equal index add up
        return array


@final
class _SparseRows(_Inert):
    def dense(self) -> np.ndarray:
        matrix = _Sparse()
        matrix.state, matrix.by_columns = self.state, False
        return matrix.dense()


@final
class _Wrapped(_Inert):
    """An array of chumpy (``Ch``), whose numbers are its attribute ``x``."""

    def dense(self) -> np.ndarray:
        if "x" not in self.state:
            raise ValueError("a pickled array of chumpy has no attribute x")
        return np.asarray(_plain(self.state["x"]))


@final
class _Selected(_Inert):
    """Selected entries of another array of chumpy (``Select``), such as the first ten shapes."""

    def dense(self) -> np.ndarray:
        source: np.ndarray = np.asarray(_plain(self.state["a"])).ravel()
        entries: np.ndarray = source[np.asarray(self.state["idxs"])]
        shape = self.state.get("preferred_shape", entries.shape)
        return np.reshape(entries, shape)


def _plain(value: Any) -> Any:
    kinds = _Sparse | _SparseRows | _Wrapped | _Selected
    return value.dense() if isinstance(value, kinds) else value


def _empty_array(kind: Any, shape: Any, code: Any) -> Any:
    if kind is not np.ndarray:
        raise pickle.UnpicklingError(f"the pickle has an array of the unknown class {kind!r}")
    array: Any = _reconstruct(kind, shape, code)
    return array


def _array_of(data: bytes, dtype: Any, shape: Any, order: str) -> np.ndarray:
    return np.frombuffer(data, dtype).reshape(shape, order="F" if order == "F" else "C")


def _scalar(dtype: np.dtype, data: Any) -> Any:
    return np.frombuffer(data, dtype)[0]


def _bytes_of(text: str, encoding: str) -> bytes:
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"the pickle encodes bytes as {encoding!r}, expected 'latin1'")
    return text.encode("latin1")


def _object_of(kind: Any, *_: Any) -> Any:
    """Create an instance of a placeholder class, in place of ``copy_reg._reconstructor``."""
    if not (isinstance(kind, type) and issubclass(kind, _Inert)):
        raise pickle.UnpicklingError(f"the pickle has an object of the unknown class {kind!r}")
    return kind()


_KNOWN: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _bytes_of,
    ("copy_reg", "_reconstructor"): _object_of,
    ("copyreg", "_reconstructor"): _object_of,
    ("__builtin__", "object"): object,
    ("builtins", "object"): object,
    # chumpy stores sets in its state; they are not used.
    ("__builtin__", "set"): set,
    ("builtins", "set"): set,
} | {
    (f"numpy.{core}.{module}", name): factory
    for core in ("core", "_core")
    for module, name, factory in (
        ("multiarray", "_reconstruct", _empty_array),
        ("multiarray", "scalar", _scalar),
        ("numeric", "_frombuffer", _array_of),
    )
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module.startswith("scipy.sparse") and name in ("csc_matrix", "csc_array"):
            return _Sparse
        if module.startswith("scipy.sparse") and name in ("csr_matrix", "csr_array"):
            return _SparseRows
        if (module, name) == ("chumpy.reordering", "Select"):
            return _Selected
        if module == "chumpy" or module.startswith("chumpy."):
            return _Wrapped
        if (module, name) in _KNOWN:
            return _KNOWN[module, name]
        raise pickle.UnpicklingError(f"the pickle names {module}.{name}, which is not an array")

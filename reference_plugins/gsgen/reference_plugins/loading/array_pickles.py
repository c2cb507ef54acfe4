"""Arrays of a pickle, read without calling anything that the file names.

The body models of SMPL are pickles of Python 2: a dict of NumPy arrays, a sparse matrix of SciPy
and, in the oldest files, arrays wrapped by chumpy. A pickle may name any function to be called; this
reader knows arrays, and refuses every other name.
"""

__all__ = ["read_array_pickle"]

import pickle
from pathlib import Path
from typing import Any, BinaryIO, final

import numpy as np
from numpy._core.multiarray import _reconstruct

from gsgen.reference_plugins.loading.errors import CheckpointInvalid


def read_array_pickle(path: Path) -> dict[str, Any]:
    """Return the dict that is pickled in ``path``; sparse and wrapped arrays become plain ones.

    It may be in an ``.npy``, as ``np.save`` writes a dict: one object in an array without axes.

    Raises:
        CheckpointInvalid: The file is damaged, holds no dict, or names anything but arrays.
    """
    try:
        with path.open("rb") as file:
            if path.suffix == ".npy":
                _pass_header(file)
            read = _Unpickler(file, encoding="latin1").load()
        if isinstance(read, np.ndarray) and read.shape == () and read.dtype == object:
            read = read.item()
        if not isinstance(read, dict):
            raise ValueError(f"holds a {type(read).__name__}, wanted a dict of arrays")
        return {str(name): _plain(value) for name, value in read.items()}
    except pickle.UnpicklingError as error:
        raise _unreadable(path, str(error)) from error
    except (ValueError, TypeError, KeyError, IndexError, EOFError, AttributeError) as error:
        raise _unreadable(path, str(error) or type(error).__name__) from error
    except (MemoryError, OverflowError, UnicodeError, RecursionError) as error:
        raise _unreadable(path, type(error).__name__) from error


def _pass_header(file: BinaryIO) -> None:
    """Go to where the pickle of an ``.npy`` begins."""
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        header = np.lib.format.read_array_header_2_0
    if not header(file)[2].hasobject:
        raise ValueError("holds an array, wanted a dict of arrays")


def _unreadable(path: Path, reason: str) -> CheckpointInvalid:
    hint = "Wanted a pickle of arrays; code in files is not run."
    return CheckpointInvalid(f"cannot be read: {reason[:200]}", where=str(path), hint=hint)


class _Inert:
    """Stands for a class of the file: keeps the state and does nothing."""

    def __init__(self, *_: Any) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, dict) else {}


@final
class _Sparse(_Inert):
    """A sparse matrix, compressed by columns or by rows."""

    by_columns = True

    def dense(self) -> np.ndarray:
        """Return it as an array."""
        shape: Any = self.state.get("_shape", self.state.get("shape"))
        starts, minor, data = (self.state[k] for k in ("indptr", "indices", "data"))
        rows, columns = (int(size) for size in shape)
        major = columns if self.by_columns else rows
        if len(starts) != major + 1 or len(minor) != len(data):
            raise ValueError("a sparse matrix does not fit its shape")
        made = np.zeros((rows, columns), np.asarray(data).dtype)
        along = np.repeat(np.arange(major), np.diff(starts))
        at = (minor, along) if self.by_columns else (along, minor)
        np.add.at(made, at, data)  # entries may be given in parts
        return made


@final
class _SparseRows(_Inert):
    def dense(self) -> np.ndarray:
        made = _Sparse()
        made.state, made.by_columns = self.state, False
        return made.dense()


@final
class _Wrapped(_Inert):
    """An array of chumpy (``Ch``), which keeps its numbers under ``x``."""

    def dense(self) -> np.ndarray:
        if "x" not in self.state:
            raise ValueError("an array of chumpy has no numbers of its own")
        return np.asarray(_plain(self.state["x"]))


@final
class _Selected(_Inert):
    """Some entries of another array of chumpy (``Select``), such as the first shapes of many."""

    def dense(self) -> np.ndarray:
        every: np.ndarray = np.asarray(_plain(self.state["a"])).ravel()
        chosen: np.ndarray = every[np.asarray(self.state["idxs"])]
        shape = self.state.get("preferred_shape", chosen.shape)
        return np.reshape(chosen, shape)


def _plain(value: Any) -> Any:
    kinds = _Sparse | _SparseRows | _Wrapped | _Selected
    return value.dense() if isinstance(value, kinds) else value


def _empty_array(kind: Any, shape: Any, code: Any) -> Any:
    if kind is not np.ndarray:
        raise pickle.UnpicklingError("an array is of an unknown class")
    made: Any = _reconstruct(kind, shape, code)
    return made


def _array_of(data: bytes, dtype: Any, shape: Any, order: str) -> np.ndarray:
    return np.frombuffer(data, dtype).reshape(shape, order="F" if order == "F" else "C")


def _scalar(dtype: np.dtype, data: Any) -> Any:
    return np.frombuffer(data, dtype)[0]


def _bytes_of(text: str, encoding: str) -> bytes:
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"bytes are encoded as {encoding!r}")
    return text.encode("latin1")


def _object_of(kind: Any, *_: Any) -> Any:
    """Make an instance as ``copy_reg._reconstructor`` would, of our own classes alone."""
    if not (isinstance(kind, type) and issubclass(kind, _Inert)):
        raise pickle.UnpicklingError("an object is of an unknown class")
    return kind()


_KNOWN: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _bytes_of,
    ("copy_reg", "_reconstructor"): _object_of,
    ("copyreg", "_reconstructor"): _object_of,
    ("__builtin__", "object"): object,
    ("builtins", "object"): object,
    # What chumpy notes of its own; nothing is done with it.
    ("__builtin__", "set"): set,
    ("builtins", "set"): set,
} | {
    (f"numpy.{core}.{module}", name): made
    for core in ("core", "_core")
    for module, name, made in (
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
        raise pickle.UnpicklingError(f"names {module}.{name}, which is no array")

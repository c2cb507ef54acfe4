"""Reads packed Gaussians or coloured points from NumPy .npz archives."""

import zipfile
from typing import Final

import numpy as np
from jaxtyping import Float, Shaped

from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES
from gsgen.formats.shared.bytes import not_recognised
from gsgen.formats.shared.errors import NotSupported, PropertyMissing, ValueInvalid, join_names
from gsgen.formats.shared.files import FilePath, open_file
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.npz_arrays import ZIP_MAGIC, read_arrays, unpacking
from gsgen.formats.shared.origins import relative_positions
from gsgen.formats.shared.splats import PackedRows, PointCloud
from gsgen.formats.shared.values import require_colors, require_finite, require_rows

__all__ = ["MAX_BYTES", "read_npz"]

MAX_BYTES: Final = 8 << 30
"""The default limit of the memory that the arrays of one archive may take, in bytes."""

_PACKED_NAMES = ("gaussians", "appearance")
_POSITION_NAMES = ("points", "xyz", "means3d")
_COLORS_KEY = "colors"


def read_npz(
    path: FilePath, *, max_bytes: int = MAX_BYTES, drop_invalid: bool = False
) -> PointCloud | PackedRows:
    """Read the packed Gaussians, or else the coloured points, of the .npz archive at ``path``.

    The first are ``gaussians`` [n, 10] and ``appearance`` [n, c] in float16 or float32, which
    is kept. Points are ``colors`` [n, 3] in uint8 or in floats from 0 to 1, and one of
    ``points``, ``xyz`` and ``means3d`` [n, 3]; both become float32, doubles relative to an origin where they need one. Other arrays are named in a FormatWarning.

    Args:
        path: The archive, as ``np.savez`` or ``np.savez_compressed`` writes it.
        max_bytes: The limit of the memory that the needed arrays may take. Their declared
            sizes are checked before they are unpacked, so a small archive of huge arrays is
            refused.
        drop_invalid: Accepted as in other readers; packed rows and points are never dropped.

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not a zip archive.
        ArchiveDamaged: The archive, or a needed array, cannot be unpacked.
        PropertyMissing: The archive lacks the needed arrays; the message lists its arrays.
        NotSupported: A needed array holds Python objects, or two arrays hold positions.
        SizeExceeded: The needed arrays would take more than ``max_bytes``.
        ValueInvalid: An array has the wrong shape, type or values.
    """
    with open_file(path) as file:
        head = file.read(RECOGNITION_BYTES)
        if not head.startswith(ZIP_MAGIC):
            raise not_recognised(head, "50 4b 03 04, the start of an .npz", head[:4].hex(" "))
        with unpacking("archive"), zipfile.ZipFile(file) as archive:
            keys = _choose_arrays([name[:-4] for name in archive.namelist() if name[-4:] == ".npy"])
            arrays = read_arrays(archive, keys, max_bytes)
            names = [name for name in archive.namelist() if name.removesuffix(".npy") not in keys]
        warn_unused(path, [f"array {name.removesuffix('.npy')}" for name in names])
        return _packed_rows(*arrays) if keys == _PACKED_NAMES else _cloud(keys[0], *arrays)


def _choose_arrays(names: list[str]) -> tuple[str, str]:
    """Choose the two arrays to read from an .npz archive: Gaussians, or points and colours."""
    if set(_PACKED_NAMES) <= set(names):
        return _PACKED_NAMES
    positions = [name for name in _POSITION_NAMES if name in names]
    if not positions or _COLORS_KEY not in names:
        raise PropertyMissing(
            f"the archive holds the arrays {join_names(names, limit=40)}",
            expected="gaussians and appearance, or colors and one of points, xyz, means3d",
        )
    if len(positions) > 1:
        raise NotSupported(
            f"the archive holds several arrays of positions: {join_names(positions)}",
            expected="only one of them",
        )
    return positions[0], _COLORS_KEY


def _packed_rows(
    gaussians: Shaped[np.ndarray, "..."], appearance: Shaped[np.ndarray, "..."]
) -> PackedRows:
    packed = PackedRows(_native_byte_order(gaussians), _native_byte_order(appearance))
    require_rows(len(packed), "array gaussians")
    return packed


def _native_byte_order(array: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Return ``array`` in C order and in the byte order of this machine."""
    return array.astype(array.dtype.newbyteorder("="), order="C", copy=False)


def _cloud(
    key: str, points: Shaped[np.ndarray, "..."], colors: Shaped[np.ndarray, "..."]
) -> PointCloud:
    position, origin, rounding = relative_positions(_triples(points, key))
    color = _triples(colors, _COLORS_KEY, extra_dtype=np.uint8).astype(np.float32, copy=False)
    require_rows(len(position), f"array {key}")
    if len(color) != len(position):
        raise ValueInvalid(
            f"the array has {len(color)} rows",
            where=f"array {_COLORS_KEY}",
            expected=f"{len(position)}, the number of rows of {key}",
        )
    if colors.dtype == np.uint8:
        color /= np.float32(255)
    require_finite(position, [f"array {key}[:, {axis}]" for axis in range(3)])
    require_colors(color, [f"array {_COLORS_KEY}[:, {axis}]" for axis in range(3)])
    return PointCloud(position, color, origin, rounding)


def _triples(
    array: Shaped[np.ndarray, "..."], key: str, *, extra_dtype: type[np.uint8] | None = None
) -> Float[np.ndarray, "n 3"]:
    """Convert an [n, 3] array of floats (or of ``extra_dtype``) to float32, doubles to float64."""
    has_valid_dtype = array.dtype.kind == "f" or array.dtype == extra_dtype
    if not has_valid_dtype or array.shape[1:] != (3,):
        dtypes = f"{np.dtype(extra_dtype).name} or float" if extra_dtype else "float"
        raise ValueInvalid(
            f"the array is {array.dtype} {list(array.shape)}",
            where=f"array {key}",
            expected=f"{dtypes} [n, 3]",
        )
    dtype = np.float64 if array.dtype.itemsize > np.dtype(np.float32).itemsize else np.float32
    return np.array(array, dtype, order="C")

"""Reads and writes SPLAT files: 32 bytes per splat, no header, SH of degree 0 only.

The format is that of antimatter15/splat: position and linear scale as three float32 each,
red, green, blue and opacity as bytes, and the quaternion (w, x, y, z) as bytes v for
(v − 128) / 128.
"""

import numpy as np
from jaxtyping import Float32

from gsgen.formats.shared.bytes import DOWNLOAD_HINT, Data, contents, read_array
from gsgen.formats.shared.errors import FileTruncated
from gsgen.formats.shared.files import FilePath, naming, replace_file
from gsgen.formats.shared.quantities import SH_C0, log, logit, sigmoid, to_bytes, unit, unit_or_zero
from gsgen.formats.shared.splat_values import drawable, linear_scale, require_drawable
from gsgen.formats.shared.splats import Splats

__all__ = ["looks_like_splat", "read_splat", "write_splat"]

ROW_DTYPE = np.dtype(
    [("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)]
)
_CHUNK_ROWS = 1 << 14
_SAMPLED_ROWS = 256
_QUATERNION_LENGTHS = (0.9, 1.1)  # of a quaternion whose components are rounded to 1/128


def read_splat(path: FilePath, *, drop_invalid: bool = False) -> Splats:
    """Read the SPLAT file at ``path``; invalid rows are refused, or dropped with a warning.

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FileTruncated: The size is not a multiple of 32 bytes.
        ValueInvalid: A value cannot be drawn: NaN, infinite, or a negative scale.
    """
    with contents(path) as data:
        return drawable(decode_splat(data), path, drop_invalid=drop_invalid)


def decode_splat(data: Data) -> Splats:
    """Return the splats of the SPLAT file ``data``, without checking their values."""
    count, remainder = divmod(len(data), ROW_DTYPE.itemsize)
    if remainder:
        raise FileTruncated(
            f"the file of {len(data)} bytes holds {count} records of 32, and {remainder} bytes more",
            where=f"byte {count * ROW_DTYPE.itemsize}",
            expected="a multiple of 32 bytes, as of a SPLAT file",
            hint=DOWNLOAD_HINT,
        )
    records = read_array(data, ROW_DTYPE, (count,), 0, "records")
    rgba = records["rgba"] / np.float32(255)
    color = (rgba[:, None, :3] - np.float32(0.5)) / np.float32(SH_C0)
    rotation = (records["rotation"].astype(np.float32) - 128) / 128
    return Splats(
        position=records["position"].astype(np.float32),
        rotation=unit_or_zero(rotation),
        log_scale=log(
            records["scale"]
        ),  # a negative scale becomes NaN, which require_drawable refuses
        logit_opacity=logit(rgba[:, 3]),
        sh=color.astype(np.float32),
    )


def write_splat(path: FilePath, splats: Splats) -> None:
    """Write ``splats`` to ``path`` as a SPLAT file.

    Positions and scales keep their float32 values. The error of opacity and colour is at most
    1/510, that of quaternions 1/256. Colour is clipped to [0, 1], and harmonics above degree 0
    are dropped. The file is written completely or not at all.

    Raises:
        ValueInvalid: ``splats`` is empty or holds values that cannot be drawn.
        FileUnwritable: The file cannot be written at ``path``.
    """
    with naming(path):
        require_drawable(splats)
        scale = linear_scale(splats)
    with replace_file(path) as file:
        for start in range(0, len(splats), _CHUNK_ROWS):
            file.write(_records(splats, scale, slice(start, start + _CHUNK_ROWS)).tobytes())


def _records(splats: Splats, scale: Float32[np.ndarray, "n 3"], part: slice) -> np.ndarray:
    records = np.empty(len(splats.position[part]), ROW_DTYPE)
    records["position"] = splats.position[part]
    records["scale"] = scale[part]
    records["rgba"][:, :3] = to_bytes((0.5 + SH_C0 * splats.sh[part, 0]) * 255)
    records["rgba"][:, 3] = to_bytes(sigmoid(splats.logit_opacity[part]) * 255)
    records["rotation"] = to_bytes(unit(splats.rotation[part]) * 128 + 128)
    return records


def looks_like_splat(head: bytes, size: int) -> bool:
    """Return whether a file can be a SPLAT file, by its size and its first records.

    The first records must hold finite positions, scales of at least 0 and quaternions of length
    one.
    """
    if size == 0 or size % ROW_DTYPE.itemsize:
        return False
    count = min(size // ROW_DTYPE.itemsize, _SAMPLED_ROWS)
    records = np.frombuffer(head, ROW_DTYPE, count)
    scale = records["scale"]
    length = np.linalg.norm((records["rotation"].astype(np.float64) - 128) / 128, axis=1)
    return bool(
        np.isfinite(records["position"]).all()
        and ((scale >= 0) & (scale < np.inf)).all()
        and ((length > _QUATERNION_LENGTHS[0]) & (length < _QUATERNION_LENGTHS[1])).all()
    )

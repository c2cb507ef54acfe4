"""Take arrays out of a file's bytes, once the file is known to be long enough for them."""

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np
from jaxtyping import Shaped
from numpy.typing import DTypeLike

from gsgen.formats.shared.errors import FileTruncated
from gsgen.formats.shared.files import FilePath, mapped, naming

Data = bytes | bytearray | memoryview | mmap.mmap
"""The bytes of a file, in memory or mapped."""

AGAIN: Final = "copy or download the file again"
MAX_BYTES: Final = 8 << 30
"""How much a compressed file may unpack to, unless the caller says more."""


@contextmanager
def contents(path: FilePath) -> Iterator[mmap.mmap]:
    """Map the file at ``path``; every FormatError of the body names it.

    Numbers that overflow on the way are no warnings: as infinity or NaN they meet the checks
    of values.

    Raises:
        FileUnreadable: It is missing, empty, no regular file, or mapping it fails.
    """
    with naming(path), mapped(path) as data, np.errstate(all="ignore"):
        yield data


def take(
    data: Data, dtype: DTypeLike, shape: tuple[int, ...], start: int, where: str
) -> Shaped[np.ndarray, "..."]:
    """Return the array at byte ``start``, as a view of ``data``.

    Args:
        data: The file.
        dtype: Of the array, byte order included.
        shape: Of the array.
        start: The offset of its first byte.
        where: What to call it in the error.

    Raises:
        FileTruncated: ``data`` ends before the array does.
    """
    kind = np.dtype(dtype)
    count = 1
    for size in shape:  # not np.prod: a hostile size may be beyond 64 bits
        count *= size
    require_room(data, start, count * kind.itemsize, where)
    return np.frombuffer(data, kind, count, start).reshape(shape)


def require_room(data: Data, start: int, needed: int, where: str) -> None:
    """Raise FileTruncated unless ``needed`` bytes from ``start`` on are in ``data``."""
    left = len(data) - start
    if start < 0 or needed > left:
        raise FileTruncated(
            f"{needed} bytes needed from byte {start} on, {max(left, 0)} are there",
            where=where,
            expected=f"a file of {start + needed} bytes or more, it has {len(data)}",
            hint=AGAIN,
        )

"""Reads arrays from the bytes of a file, after checking that the file is long enough."""

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np
from jaxtyping import Shaped
from numpy.typing import DTypeLike

from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, kind_of
from gsgen.formats.shared.errors import FileTruncated, FormatNotRecognised
from gsgen.formats.shared.files import FilePath, map_file, naming

Data = bytes | bytearray | memoryview | mmap.mmap
"""The bytes of a file, in memory or mapped."""

DOWNLOAD_HINT: Final = "copy or download the file again"
MAX_SPLATS: Final = 2**31 - 1
"""The most splats of a file whose counts other readers store as int32."""
MAX_BYTES: Final = 8 << 30
"""The default limit of the bytes that a compressed file may unpack to."""
MAX_INFLATION: Final = 1040
"""The most bytes that deflate unpacks from one."""


@contextmanager
def contents(path: FilePath) -> Iterator[mmap.mmap]:
    """Map a file into memory; format errors in the ``with`` block then name the file.

    Overflows raise no warnings: the checks of values refuse the resulting infinity or NaN.
    """
    with naming(path), map_file(path) as data, np.errstate(all="ignore"):
        yield data


def read_array(
    data: Data, dtype: DTypeLike, shape: tuple[int, ...], start: int, where: str
) -> Shaped[np.ndarray, "..."]:
    """Return an array view of ``data`` from byte ``start`` on."""
    kind = np.dtype(dtype)
    count = 1
    for size in shape:  # not np.prod: a hostile size may be beyond 64 bits
        count *= size
    require_length(data, start, count * kind.itemsize, where)
    return np.frombuffer(data, kind, count, start).reshape(shape)


def require_length(data: Data, start: int, needed: int, where: str) -> None:
    """Raise FileTruncated unless ``data`` has ``needed`` bytes from ``start`` on."""
    remaining = len(data) - start
    if start < 0 or needed > remaining:
        raise FileTruncated(
            f"the data need {needed} bytes from byte {start} on, but {max(remaining, 0)} are left",
            where=where,
            expected=f"a file of {start + needed} bytes or more; it has {len(data)}",
            hint=DOWNLOAD_HINT,
        )


def not_recognised(data: Data, expected: str, magic_text: str) -> FormatNotRecognised:
    """Return the error about a file whose content is not that of the format that is read.

    Args:
        data: The file, or its beginning.
        expected: The expected content.
        magic_text: The first bytes, for content of no known kind.
    """
    kind = kind_of(bytes(data[:RECOGNITION_BYTES]))
    if kind is None:
        return FormatNotRecognised(magic_text, where="first bytes", expected=expected)
    return FormatNotRecognised(f"this is {kind.title}", expected=expected, hint=kind.hint)

"""Reads KSPLAT files, version 0.1, of all three compression levels.

The format is that of mkkellogg/GaussianSplats3D: a header, a header for each section, and
sections of buckets, whose splats have positions relative to the centre of their bucket.
"""

import struct
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float32, Shaped

from gsgen.formats.shared.bytes import (
    DOWNLOAD_HINT,
    Data,
    contents,
    not_recognised,
    read_array,
    require_length,
)
from gsgen.formats.shared.errors import HeaderMalformed, NotSupported, ValueInvalid
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.quantities import SH_C0, log, logit, unit_or_zero
from gsgen.formats.shared.splat_values import drawable
from gsgen.formats.shared.splats import SH_COUNTS, Splats

__all__ = ["looks_like_ksplat", "read_ksplat"]

FILE_HEADER_BYTES: Final = 4096
SECTION_HEADER_BYTES: Final = 1024

_FILE_HEADER = struct.Struct("<BB2xIIIIHxx3f2f")
_SECTION_HEADER = struct.Struct("<IIIIfH2xI4xIIH")
_SH_RANGE = (-1.5, 1.5)
_POSITION_DTYPES = ("<f4", "<u2", "<u2")
_SCALAR_DTYPES = ("<f4", "<f2", "<f2")
_SH_DTYPES = ("<f4", "<f2", "u1")
_SCALE_RANGE = 32767
_MAX_DEGREE = 2


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _KsplatSection:
    """The header of one section of a KSPLAT file: counts, sizes and quantisation.

    Attributes:
        start: The byte where the section's data begin.
        buckets: The byte where the centres of the buckets begin.
        rows: The byte where the splats begin.
        end: The byte after the data.
    """

    count: int
    degree: int
    bucket_size: int
    bucket_count: int
    block_size: float
    storage: int
    scale_range: int
    full_count: int
    partial_count: int
    start: int
    buckets: int
    rows: int
    end: int


def read_ksplat(path: FilePath, *, drop_invalid: bool = False) -> Splats:
    """Read the KSPLAT file at ``path`` as splats of the highest SH degree in the file.

    Invalid rows are refused, or dropped with a warning.

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not a KSPLAT file.
        NotSupported: The file has another version.
        HeaderMalformed: A header contradicts itself.
        FileTruncated: The file ends early.
        ValueInvalid: The file has no splats, or one that cannot be drawn.
    """
    with contents(path) as data:
        splats, end = _decode_ksplat(data)
        trailing_bytes = len(data) - end
        text = f"{trailing_bytes:,} bytes after the last section"
        warn_unused(path, [text] if trailing_bytes else [])
        return drawable(splats, path, drop_invalid=drop_invalid)


def looks_like_ksplat(head: bytes, size: int) -> bool:
    """Return whether a file starts like a KSPLAT file, with a known version and valid sizes."""
    if size < FILE_HEADER_BYTES:
        return False
    major, minor, sections, _, _, _, level, *_ = _FILE_HEADER.unpack_from(head)
    is_reserved_zero = head[2:4] == b"\0\0"
    known = (major, minor) == (0, 1) and is_reserved_zero and level <= 2
    return known and sections > 0 and FILE_HEADER_BYTES + sections * SECTION_HEADER_BYTES <= size


def _decode_ksplat(data: Data) -> tuple[Splats, int]:
    """Return the unchecked splats of the KSPLAT file ``data``, and the end of its last section."""
    require_length(data, 0, FILE_HEADER_BYTES, "header")
    fields = _FILE_HEADER.unpack_from(data)
    major, minor, sections, _, _, _, level, _, _, _, sh_low, sh_high = fields
    if major or data[2:4] != b"\0\0":
        magic_text = bytes(data[:4]).hex(" ")
        raise not_recognised(data, "00 01 00 00, the start of KSPLAT 0.1", magic_text)
    if minor != 1:
        raise NotSupported(
            f"the file has KSPLAT version 0.{minor}", where="byte 1", expected="version 0.1"
        )
    if level > 2:
        raise HeaderMalformed(
            f"the compression level is {level}", where="byte 20", expected="0, 1 or 2"
        )
    # The number of used sections (byte 8) is not read: writers leave it 0, and the others empty.
    require_length(data, FILE_HEADER_BYTES, sections * SECTION_HEADER_BYTES, "section headers")
    sh_range = (sh_low or _SH_RANGE[0], sh_high or _SH_RANGE[1])
    start = FILE_HEADER_BYTES + sections * SECTION_HEADER_BYTES
    parts: list[Splats] = []
    for index in range(sections):
        section = _section(data, index, start, level)
        start = section.end
        if section.count:
            parts.append(_splats(data, section, level, sh_range))
    if not parts:
        raise ValueInvalid("the file has 0 splats", where="sections", expected="at least one")
    return join_splats(parts), start


def _section(data: Data, index: int, start: int, level: int) -> _KsplatSection:
    offset = FILE_HEADER_BYTES + index * SECTION_HEADER_BYTES
    fields = _SECTION_HEADER.unpack_from(data, offset)
    count, most, size, buckets, block_size, storage, scale, full_count, partial_count, degree = (
        fields
    )
    where = f"section {index}, byte {offset}"
    if degree > _MAX_DEGREE:
        raise HeaderMalformed(f"the SH degree is {degree}", where=where, expected="0, 1 or 2")
    if count > most:
        raise HeaderMalformed(
            f"the section has {count} splats, but a capacity of {most}",
            where=where,
            expected=f"at most {most} splats",
        )
    if level and not count <= full_count * size + partial_count * size:
        raise HeaderMalformed(
            f"the section has {count} splats in {full_count} full and {partial_count} partial buckets of {size}",
            where=where,
            expected=f"at most {full_count * size + partial_count * size} splats",
        )
    if (
        level
        and count
        and (full_count + partial_count > buckets or storage < 12 or not np.isfinite(block_size))
    ):
        raise HeaderMalformed(
            f"the section has {buckets} buckets, stored in {storage} bytes each, of edge length {block_size:g}",
            where=where,
            expected=f"at least {full_count + partial_count} buckets of at least 12 bytes, of finite edge length",
        )
    bucket_centres = start + 4 * partial_count
    rows = bucket_centres + storage * buckets
    end = rows + most * _record(level, degree).itemsize
    require_length(data, start, end - start, where)
    return _KsplatSection(
        count=count, degree=degree, bucket_size=size, bucket_count=buckets, block_size=block_size, storage=storage, scale_range=scale or _SCALE_RANGE, full_count=full_count, partial_count=partial_count,
        start=start, buckets=bucket_centres, rows=rows, end=end,
    )  # fmt: skip


def _record(level: int, degree: int) -> np.dtype:
    fields = [
        ("position", _POSITION_DTYPES[level], 3),
        ("scale", _SCALAR_DTYPES[level], 3),
        ("rotation", _SCALAR_DTYPES[level], 4),
        ("rgba", "u1", 4),
        ("sh", _SH_DTYPES[level], 3 * (SH_COUNTS[degree] - 1)),
    ]
    return np.dtype(fields)


def _splats(
    data: Data, section: _KsplatSection, level: int, sh_range: tuple[float, float]
) -> Splats:
    record = _record(level, section.degree)
    rows = read_array(data, record, (section.count,), section.rows, "splats")
    rgba = rows["rgba"] / np.float32(255)
    constant = (rgba[:, None, :3] - np.float32(0.5)) / np.float32(SH_C0)
    higher_sh = _harmonics(rows["sh"], level, sh_range)
    return Splats(
        position=_positions(data, section, rows, level),
        rotation=unit_or_zero(rows["rotation"]),
        log_scale=log(
            rows["scale"]
        ),  # a negative scale becomes NaN, which require_drawable refuses
        logit_opacity=logit(rgba[:, 3]),
        sh=np.concatenate([constant, higher_sh], axis=1).astype(np.float32),
    )


def _positions(
    data: Data, section: _KsplatSection, rows: Shaped[np.ndarray, " n"], level: int
) -> Float32[np.ndarray, "n 3"]:
    stored = rows["position"]
    if not level:
        return stored.astype(np.float32)
    steps = stored.astype(np.float64) - section.scale_range
    step = section.block_size / 2 / section.scale_range
    return np.asarray(steps * step + _bucket_centres(data, section), np.float32)


def _bucket_centres(data: Data, section: _KsplatSection) -> Float32[np.ndarray, "n 3"]:
    """Return the centre of the KSPLAT bucket (spatial block) that each splat belongs to."""
    lengths = read_array(data, "<u4", (section.partial_count,), section.start, "bucket lengths")
    if (lengths > section.bucket_size).any():
        raise HeaderMalformed(
            f"a bucket holds {int(lengths.max())} splats",
            where=f"bucket lengths, byte {section.start}",
            expected=f"{section.bucket_size} or fewer",
            hint=DOWNLOAD_HINT,
        )
    kind = np.dtype([("middle", "<f4", 3), ("rest", "u1", section.storage - 12)])
    bucket_centres = read_array(data, kind, (section.bucket_count,), section.buckets, "buckets")
    ends = np.concatenate(
        [
            np.arange(1, section.full_count + 1, dtype=np.int64) * section.bucket_size,
            section.full_count * section.bucket_size + np.cumsum(lengths, dtype=np.int64),
        ]
    )
    if section.count and (not len(ends) or ends[-1] < section.count):
        raise HeaderMalformed(
            f"the section has {section.count} splats, its buckets {int(ends[-1]) if len(ends) else 0}",
            where=f"bucket lengths, byte {section.start}",
            expected="all splats in buckets",
            hint=DOWNLOAD_HINT,
        )
    bucket = np.searchsorted(ends, np.arange(section.count), side="right")
    return np.asarray(bucket_centres["middle"][bucket])


def _harmonics(
    stored: Shaped[np.ndarray, "n m"], level: int, sh_range: tuple[float, float]
) -> Float32[np.ndarray, "n k 3"]:
    """Decode the KSPLAT SH coefficients above degree 0, stored channel by channel per degree."""
    values = stored.astype(np.float32)
    if level == 2:
        low, high = sh_range
        values = np.asarray(low + values / 255 * (high - low), np.float32)
    first_band, second_band = values[:, :9], values[:, 9:]
    degrees = [part.reshape(len(part), 3, -1) for part in (first_band, second_band) if part.size]
    coefficients = [part.swapaxes(1, 2) for part in degrees]
    empty_sh = np.empty((len(stored), 0, 3), np.float32)
    return np.concatenate([empty_sh, *coefficients], axis=1).astype(np.float32)

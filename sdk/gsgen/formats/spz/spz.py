"""Reads and writes SPZ files, versions 1 to 4: quantised, a tenth of the size of a PLY file.

The format is that of nianticlabs/spz.
"""

import math
from collections.abc import Iterable
from contextlib import ExitStack
from functools import partial
from tempfile import TemporaryFile

import numpy as np

from gsgen.formats.shared.axes import AxisSigns, axis_signs, flip
from gsgen.formats.shared.bytes import MAX_BYTES, contents
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.files import FilePath, naming, replace_file
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.splat_values import drawable, require_drawable
from gsgen.formats.shared.splats import Splats
from gsgen.formats.spz import container as container
from gsgen.formats.spz import streams as streams

__all__ = ["FRACTIONAL_BITS", "SH_BITS", "VERSION", "read_spz", "write_spz", "write_spz_parts"]

VERSION = 3
"""The default version of written files: version 4 needs zstd, and few viewers read it."""
FRACTIONAL_BITS = 12
"""The bits after the binary point of coordinates up to 2048 units; larger scenes get fewer."""
SH_BITS = (5, 4)
"""The kept bits of eight for harmonics of degree 1, and of higher degrees."""

SPZ_AXES = "RUB"
"""The axes of the format: x right, y up, z back."""

_MAX_FLOAT16 = 65504.0
_READ_BYTES = 1 << 20


def read_spz(
    path: FilePath,
    *,
    max_bytes: int = MAX_BYTES,
    axes: str | None = None,
    drop_invalid: bool = False,
) -> Splats:
    """Read the SPZ file at ``path``, of version 1, 2, 3 or 4.

    Axes are converted from x right, y up, z back, or from the declared system, to those of a PLY.

    Args:
        path: The file.
        max_bytes: The limit of the unpacked attributes, in bytes.
        axes: The axes of the file, such as ``RDF``, which some programs write without declaring
            it; None for those of the format.
        drop_invalid: Drop rows that cannot be drawn, and warn about them.

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not an SPZ file.
        NotSupported: The version is later than 4, the axes are swapped, or the package
            zstandard is needed and missing.
        HeaderMalformed: The header contradicts itself or the size of the file.
        FileTruncated: The file ends early.
        ArchiveDamaged: The data cannot be unpacked.
        SizeExceeded: The attributes need more than ``max_bytes``.
        ValueInvalid: The file has no splats, or one that cannot be drawn.
    """
    with contents(path) as data:
        frame = container.unpack(data, max_bytes)
        warn_unused(path, frame.unused)
        splats = _decode(frame, None if axes is None else axis_signs(axes))
        return drawable(splats, path, drop_invalid=drop_invalid)


def _decode(frame: container.Frame, signs: AxisSigns | None) -> Splats:
    """Return the splats of an unpacked SPZ file, in the coordinate axes of a PLY file."""
    splats = streams.decode(
        frame.streams,
        version=frame.version,
        degree=frame.degree,
        fractional_bits=frame.fractional_bits,
        antialiased=frame.antialiased,
    )
    return _with_flipped_axes(splats, frame.signs if signs is None else signs)


def _with_flipped_axes(splats: Splats, signs: AxisSigns) -> Splats:
    """Convert splats to other coordinate axes, exactly as the library nianticlabs/spz does.

    That code treats the harmonic of degree 4 and order 4, x⁴ − 6x²y² + y⁴, as odd in y. It is
    even, but existing files are written and read like this.
    """
    flipped_splats = flip(splats, signs)
    if flipped_splats.degree == 4 and signs[1] < 0:
        flipped_splats.sh[:, -1] *= -1
    return flipped_splats


def write_spz(
    path: FilePath,
    splats: Splats,
    *,
    version: int = VERSION,
    sh_bits: tuple[int, int] = SH_BITS,
    axes: str = SPZ_AXES,
) -> None:
    """Write ``splats`` to ``path`` as an SPZ file.

    The error is at most half a step. Steps are: positions 1/4096 (or twice that for every doubling
    of a scene beyond 2048 units; float16 in version 1), opacity and colour 1/255 of their
    range, the colour coefficient 1/38, log scale 1/16 from -10 to 5.9, quaternions 1/723
    (1/127.5 up to version 2), harmonics 1/16 and 1/8 from -1 to 1. Values outside of a
    range are clipped. The file is written completely or not at all.

    Args:
        path: The output path; an existing file is replaced.
        splats: The splats.
        version: The version, 1 to 4; 4 needs the package zstandard.
        sh_bits: The kept bits of eight for harmonics of degree 1, and of higher degrees.
        axes: The axes of the file. Others than those of the format are not declared in it.

    Raises:
        ValueInvalid: ``splats`` is empty, holds values that cannot be drawn or exceeds
            the range of the format, or ``version`` or ``sh_bits`` is invalid.
        FileTruncated: All splats are equal, so that zstd packs them into fewer bytes than
            readers accept for their count; version 3 works.
        NotSupported: The package zstandard is needed and missing.
        FileUnwritable: The file cannot be written at ``path``.
    """
    with naming(path):
        _require_options(version, sh_bits)
        require_drawable(splats)
        fraction = _fractional_bits(float(np.abs(splats.position).max()), version)
        content = streams.encode(
            _with_flipped_axes(splats, axis_signs(axes)),
            version=version,
            fractional_bits=fraction,
            sh_bits=sh_bits,
        )
        frame = container.Frame(
            version=version,
            count=len(splats),
            degree=splats.degree,
            fractional_bits=fraction,
            antialiased=splats.antialiased,
            streams={},
        )
        packed = container.pack(frame, content)
        container.require_count(len(splats), len(packed))
    with replace_file(path) as file:
        file.write(packed)


def write_spz_parts(
    path: FilePath, parts: Iterable[Splats], count: int, max_coordinate: float
) -> None:
    """Write splats that come in parts of equal SH degree and flags as an SPZ file, version 3.

    Encoded attributes are kept in temporary files until all parts are read.

    Args:
        path: The output path; an existing file is replaced.
        parts: The splats.
        count: The number of all splats.
        max_coordinate: The largest absolute coordinate of all splats.

    Raises:
        ValueInvalid: A coordinate exceeds the range of the format.
        FileUnwritable: The file cannot be written at ``path``.
    """
    with ExitStack() as stack:
        files = {name: stack.enter_context(TemporaryFile()) for name in streams.STREAM_NAMES}
        fraction = _fractional_bits(max_coordinate, VERSION)
        degree, antialiased = 0, False
        for part in parts:
            degree, antialiased = part.degree, part.antialiased
            flipped_splats = _with_flipped_axes(part, axis_signs(SPZ_AXES))
            content = streams.encode(
                flipped_splats, version=VERSION, fractional_bits=fraction, sh_bits=SH_BITS
            )
            for name, data in content.items():
                files[name].write(data)
        frame = container.Frame(
            version=VERSION,
            count=count,
            degree=degree,
            fractional_bits=fraction,
            antialiased=antialiased,
            streams={},
        )
        for attribute in files.values():
            attribute.seek(0)
        pieces = (iter(partial(attribute.read, _READ_BYTES), b"") for attribute in files.values())
        with replace_file(path) as file:
            file.writelines(container.pack_gzip(frame, pieces))
            container.require_count(count, file.tell())


def _fractional_bits(max_coordinate: float, version: int) -> int:
    """Return how many fractional bits, up to 12, SPZ positions can have without overflow."""
    uses_float16 = version <= streams.HALF_POSITIONS
    limit = _MAX_FLOAT16 if uses_float16 else float(streams.COORDINATE_LIMIT)
    if max_coordinate > limit:
        raise ValueInvalid(
            f"the largest coordinate is {max_coordinate:g}",
            where="position",
            expected=f"at most {limit:g} in an SPZ file of version {version}",
            hint="scale the scene down, or write another format",
        )
    spare_bits = int(math.log2(streams.COORDINATE_LIMIT / max(max_coordinate, 1)))
    return min(FRACTIONAL_BITS, spare_bits)


def _require_options(version: int, sh_bits: tuple[int, int]) -> None:
    if not 1 <= version <= container.NEWEST_VERSION:
        raise ValueInvalid(
            f"the version of SPZ is {version}", where="version", expected="1, 2, 3 or 4"
        )
    if len(sh_bits) != 2 or not all(1 <= bits <= 8 for bits in sh_bits):
        raise ValueInvalid(
            f"the SH bits are {sh_bits}", where="sh_bits", expected="two numbers, 1 to 8"
        )

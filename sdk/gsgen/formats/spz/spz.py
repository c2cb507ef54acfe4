"""Read and write SPZ files, versions 1 to 4: a tenth of the size of a PLY file, rounded.

The format is that of nianticlabs/spz.
"""

import math

import numpy as np

from gsgen.formats.shared.axes import RDF_RUB, Signs, flip
from gsgen.formats.shared.bytes import MAX_BYTES, Data, contents
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.files import FilePath, naming, replacing
from gsgen.formats.shared.splat_values import require_drawable
from gsgen.formats.shared.splats import Splats
from gsgen.formats.spz import container as container
from gsgen.formats.spz import streams as streams

__all__ = ["FRACTIONAL_BITS", "SH_BITS", "VERSION", "read_spz", "write_spz"]

VERSION = 3
"""What is written unless asked otherwise: version 4 needs zstd, and few viewers read it."""
FRACTIONAL_BITS = 12
"""Of coordinates, which reach to 2048 units in steps of 1/4096; fewer where that is too short."""
SH_BITS = (5, 4)
"""How many of eight bits of the harmonics are kept: of degree 1, and above."""

_LARGEST_HALF = 65504.0


def read_spz(path: FilePath, *, max_bytes: int = MAX_BYTES) -> Splats:
    """Read the SPZ file at ``path``, of version 1, 2, 3 or 4.

    Axes are turned from x right, y up, z back, or what the file declares, to those of a PLY.

    Args:
        path: The file.
        max_bytes: What the attributes may unpack to.

    Raises:
        FileUnreadable: The file is missing, empty or closed to us.
        NotRecognised: It is no SPZ file.
        NotSupported: It is of a later version, in a space with swapped axes, or in zstd
            where the package zstandard is missing.
        HeaderMalformed: The header contradicts itself or the size of the file.
        FileTruncated: The file ends early.
        ArchiveDamaged: The data cannot be unpacked.
        SizeExceeded: The attributes would take more than ``max_bytes``.
        ValueInvalid: There is no splat, or one that cannot be drawn.
    """
    with contents(path) as data:
        return decode_spz(data, max_bytes)


def decode_spz(data: Data, max_bytes: int = MAX_BYTES) -> Splats:
    """Return the splats of the SPZ file ``data``, with the axes of a PLY file."""
    frame = container.unpack(data, max_bytes)
    splats = streams.decode(
        frame.streams,
        version=frame.version,
        degree=frame.degree,
        fractional_bits=frame.fractional_bits,
        antialiased=frame.antialiased,
    )
    require_drawable(splats)
    return _turned(splats, frame.signs)


def _turned(splats: Splats, signs: Signs) -> Splats:
    """Return ``splats`` with other axes, as the code of nianticlabs/spz turns them.

    It takes the harmonic of degree 4 and order 4, x⁴ − 6x²y² + y⁴, for odd in y. It is even;
    but the files that there are were written like this, and are read like this elsewhere.
    """
    made = flip(splats, signs)
    if made.degree == 4 and signs[1] < 0:
        made.sh[:, -1] *= -1
    return made


def write_spz(
    path: FilePath,
    splats: Splats,
    *,
    version: int = VERSION,
    sh_bits: tuple[int, int] = SH_BITS,
) -> None:
    """Write ``splats`` to ``path`` as an SPZ file.

    What comes back is within half a step: positions 1/4096 (or twice that for every doubling
    of a scene beyond 2048 units; float16 in version 1), opacity and colour 1/255 of their
    range, the colour coefficient 1/38, log scale 1/16 from -10 to 5.9, quaternions 1/723
    (1/127.5 up to version 2), harmonics 1/16 and 1/8 from -1 to 1. What lies outside of a
    range is cut. The file appears whole or not at all.

    Args:
        path: Where to; a file that is there is replaced.
        splats: What to write.
        version: 1 to 4; 4 needs the package zstandard.
        sh_bits: How many of eight bits are kept of harmonics of degree 1 and above it.

    Raises:
        ValueInvalid: ``splats`` is empty, holds values that cannot be drawn or is larger
            than the format can hold, or there is no such version or number of bits.
        FileTruncated: All splats are alike, so that zstd makes a file of which readers would
            say that it cannot hold as many; version 3 can be.
        NotSupported: The package zstandard is needed and missing.
        FileUnwritable: The file could not be written or put in place.
    """
    with naming(path):
        _require_options(version, sh_bits)
        require_drawable(splats)
        fraction = _fractional_bits(splats, version)
        content = streams.encode(
            _turned(splats, RDF_RUB),
            version=version,
            fractional_bits=fraction,
            sh_bits=sh_bits,
        )
        frame = container.Frame(
            version, len(splats), splats.degree, fraction, splats.antialiased, {}
        )
        packed = container.pack(frame, content)
        container.require_count(len(splats), len(packed))
    with replacing(path) as file:
        file.write(packed)


def _fractional_bits(splats: Splats, version: int) -> int:
    """Return the finest steps, at most 1/4096, with which all coordinates fit."""
    reach = float(np.abs(splats.position).max())
    half = version <= streams.HALF_POSITIONS
    limit = _LARGEST_HALF if half else float(streams.COORDINATE_LIMIT)
    if reach > limit:
        raise ValueInvalid(
            f"a coordinate of {reach:g}",
            where="position",
            expected=f"{limit:g} or less, to be an SPZ file of version {version}",
            hint="scale the scene down, or write another format",
        )
    spare = int(math.log2(streams.COORDINATE_LIMIT / max(reach, 1)))
    return min(FRACTIONAL_BITS, spare)


def _require_options(version: int, sh_bits: tuple[int, int]) -> None:
    if not 1 <= version <= container.LAST:
        raise ValueInvalid(str(version), where="version", expected="1, 2, 3 or 4")
    if len(sh_bits) != 2 or not all(1 <= bits <= 8 for bits in sh_bits):
        raise ValueInvalid(str(sh_bits), where="sh_bits", expected="two numbers, 1 to 8")

"""Encodes and decodes the six attribute streams of an SPZ file.

The format is that of nianticlabs/spz, in the file's own space (x right, y up, z back).
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, UInt8

from gsgen.formats.shared.quantities import (
    logit,
    quaternions_from_largest,
    rounded,
    sigmoid,
    to_bytes,
    unit,
    without_largest,
)
from gsgen.formats.shared.splats import SH_COUNTS, Splats

STREAM_NAMES: Final = ("positions", "alphas", "colors", "scales", "rotations", "sh")
"""The attributes in the order of the file."""
HALF_POSITIONS, BYTE_ROTATIONS = 1, 2
"""The last version with float16 positions, and the last one with rotations of three bytes."""
COORDINATE_LIMIT: Final = (1 << 23) - 1
"""The largest 24-bit coordinate."""

_COLOR_SCALE = 0.15
_QUATERNION_MAGNITUDE = 511
_SQRT_HALF = float(np.sqrt(0.5))


def sizes(version: int, count: int, degree: int) -> dict[str, int]:
    """Return the size in bytes of each SPZ attribute for ``count`` splats."""
    widths = (
        6 if version <= HALF_POSITIONS else 9,
        1,
        3,
        3,
        3 if version <= BYTE_ROTATIONS else 4,
        3 * (SH_COUNTS[degree] - 1),
    )
    return {name: count * size for name, size in zip(STREAM_NAMES, widths, strict=True)}


def decode(
    streams: Mapping[str, UInt8[np.ndarray, " b"]],
    *,
    version: int,
    degree: int,
    fractional_bits: int,
    antialiased: bool,
) -> Splats:
    """Decode SPZ attribute streams to splats, in the coordinate axes of the SPZ file."""
    count = len(streams["alphas"])
    colors = streams["colors"].reshape(count, 1, 3) / np.float32(255)
    higher_sh = streams["sh"].reshape(count, SH_COUNTS[degree] - 1, 3).astype(np.float32)
    sh = np.concatenate([(colors - 0.5) / _COLOR_SCALE, (higher_sh - 128) / 128], axis=1)
    decode_rotations = (
        _decode_byte_rotations if version <= BYTE_ROTATIONS else _decode_word_rotations
    )
    return Splats(
        position=_decode_positions(streams["positions"], count, version, fractional_bits),
        rotation=decode_rotations(streams["rotations"]),
        log_scale=streams["scales"].reshape(count, 3) / np.float32(16) - np.float32(10),
        logit_opacity=logit(np.arange(256) / np.float32(255))[streams["alphas"]],
        sh=np.asarray(sh, np.float32),
        antialiased=antialiased,
    )


def _decode_positions(
    stream: UInt8[np.ndarray, " b"], count: int, version: int, fractional_bits: int
) -> Float32[np.ndarray, "n 3"]:
    if version <= HALF_POSITIONS:
        return stream.view("<f2").reshape(count, 3).astype(np.float32)
    parts = stream.reshape(count, 3, 3).astype(np.int32)
    unsigned_coordinates = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    signed_values = unsigned_coordinates - ((unsigned_coordinates & 0x800000) << 1)
    return np.ldexp(signed_values.astype(np.float32), -fractional_bits)


def _decode_byte_rotations(stream: UInt8[np.ndarray, " b"]) -> Float32[np.ndarray, "n 4"]:
    xyz = stream.reshape(-1, 3) / np.float64(127.5) - 1
    w = np.sqrt(np.maximum(1 - np.square(xyz).sum(axis=1), 0))
    return unit(np.column_stack([w, xyz]))


def _decode_word_rotations(stream: UInt8[np.ndarray, " b"]) -> Float32[np.ndarray, "n 4"]:
    words = stream.view("<u4")
    smaller = np.empty((len(words), 3))
    for index in range(3):  # the last of the three has the lowest bits
        field = words >> np.uint32(10 * (2 - index)) & 0x3FF
        size = (field & 0x1FF) / _QUATERNION_MAGNITUDE * _SQRT_HALF
        smaller[:, index] = np.where(field & 0x200, -size, size)
    xyzw = quaternions_from_largest((words >> 30).astype(np.int64), smaller)
    return unit(xyzw[:, [3, 0, 1, 2]])


def encode(
    splats: Splats, *, version: int, fractional_bits: int, sh_bits: Sequence[int]
) -> dict[str, bytes]:
    """Encode ``splats`` as SPZ attribute streams."""
    log_scale = np.maximum(splats.log_scale, np.float32(-10))  # -inf becomes the smallest too
    encode_rotations = (
        _encode_word_rotations if version > BYTE_ROTATIONS else _encode_byte_rotations
    )
    return {
        "positions": _encode_positions(splats.position, version, fractional_bits),
        "alphas": to_bytes(sigmoid(splats.logit_opacity) * 255).tobytes(),
        "colors": to_bytes((splats.sh[:, 0] * _COLOR_SCALE + 0.5) * 255).tobytes(),
        "scales": to_bytes((log_scale + 10) * 16).tobytes(),
        "rotations": encode_rotations(unit(splats.rotation)),
        "sh": _encode_harmonics(splats.sh[:, 1:], sh_bits).tobytes(),
    }


def _encode_positions(
    position: Float32[np.ndarray, "n 3"], version: int, fractional_bits: int
) -> bytes:
    if version <= HALF_POSITIONS:
        return position.astype("<f2").tobytes()
    steps = np.ldexp(position.astype(np.float64), fractional_bits)
    coordinate_words = rounded(steps, -COORDINATE_LIMIT, COORDINATE_LIMIT).astype("<i4")
    return coordinate_words.view(np.uint8).reshape(-1, 3, 4)[..., :3].tobytes()


def _encode_byte_rotations(rotation: Float32[np.ndarray, "n 4"]) -> bytes:
    signed_values = rotation[:, 1:] * np.where(rotation[:, :1] < 0, -1, 1)
    return to_bytes(signed_values * 127.5 + 127.5).tobytes()


def _encode_word_rotations(rotation: Float32[np.ndarray, "n 4"]) -> bytes:
    largest, smaller = without_largest(rotation[:, [1, 2, 3, 0]])
    sizes = rounded(np.abs(smaller) / _SQRT_HALF * _QUATERNION_MAGNITUDE, 0, _QUATERNION_MAGNITUDE)
    fields = np.where(smaller < 0, 0x200, 0) | sizes
    words = largest << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]
    return bytes(words.astype("<u4").tobytes())


def _encode_harmonics(
    sh: Float[np.ndarray, "n k 3"], sh_bits: Sequence[int]
) -> UInt8[np.ndarray, "n k 3"]:
    """Quantise SH coefficients for SPZ to steps of a power of two, which compresses well."""
    first = SH_COUNTS[1] - 1
    codes = np.empty(sh.shape, np.uint8)
    for part, bits in ((slice(first), sh_bits[0]), (slice(first, None), sh_bits[1])):
        width = 1 << (8 - bits)
        steps = np.rint(sh[:, part] * 128.0 + 128) + width // 2
        codes[:, part] = np.clip(np.floor(steps / width) * width, 0, 255)
    return codes

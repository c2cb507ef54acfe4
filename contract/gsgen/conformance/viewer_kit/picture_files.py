"""Reads a viewer's pictures from .npy and .png files, and writes PNGs; needs only NumPy.

The kit's script holds this module as text, so that it runs alone.
"""

import re
import struct
import zlib
from pathlib import Path

import numpy as np

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_ARRAY_MAGIC = b"\x93NUMPY"
_CHANNELS_BY_COLOR_TYPE = {0: 1, 2: 3, 4: 2, 6: 4}
_MAX_BYTES = 64 << 20
_MAX_FLOAT_VALUE = 8.0  # floats beyond it are in another unit, such as 0 to 255


class PictureUnreadable(ValueError):
    """Raised if a viewer's picture cannot be read."""

    cause = "unreadable"


class PictureMissing(PictureUnreadable):
    """Raised if the folder holds no picture of a frame."""

    cause = "missing"


def read_picture(folder: Path, name: str) -> np.ndarray:
    """Read a viewer's picture from .npy or .png as floats [h, w, 3], composited over black."""
    array_path, image_path = folder / f"{name}.npy", folder / f"{name}.png"
    path = array_path if array_path.is_file() else image_path
    if not path.is_file():
        raise PictureMissing(
            f"{name}: the picture is missing: expected {array_path.name} or {image_path.name}"
            + _similar_file_name(folder, name)
        )
    if array_path.is_file() and image_path.is_file():
        raise PictureUnreadable(
            f"{name}: there are two pictures, {array_path.name} and {image_path.name}, "
            "expected one: delete the one that is out of date"
        )
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise PictureUnreadable(f"the file is larger than the limit of {_MAX_BYTES:,} bytes")
        if path is image_path:
            return _composite_picture_over_black(decode_png(path.read_bytes()))
        return _read_array_over_black(path)
    except PictureUnreadable as error:
        raise PictureUnreadable(f"{path}: {error}") from error
    except OSError as error:
        raise PictureUnreadable(f"{path}: the picture cannot be read: {error.strerror}") from error


def _similar_file_name(folder: Path, name: str) -> str:
    """Return a hint at the file that may be the picture ``name`` by another name, or nothing."""
    case, number = _name_parts(name)
    name_parts = {path.name: _name_parts(path.stem) for path in sorted(folder.iterdir())}
    for file, parts in name_parts.items():
        if parts == (case, number):
            return f"; found {file}, whose name or format is another"
    for file, parts in name_parts.items():
        if parts == (case, number + 1):
            return f"; found {file}, and frames are counted from 0"
    return ""


def _name_parts(stem: str) -> tuple[str, int]:
    """Return the case of a picture's name, whose spelling may vary, and the number of its frame."""
    words = re.findall("[a-z0-9]+", stem.lower())
    if len(words) > 1 and words[-1].isdecimal() and len(words[-1]) < 9:
        return "-".join(words[:-1]), int(words[-1])
    return "-".join(words), 0


def _read_array_over_black(path: Path) -> np.ndarray:
    """Read floats [h, w, 3 or 4] from a .npy file; drop alpha, which is multiplied already."""
    with path.open("rb") as file:
        magic = file.read(len(_ARRAY_MAGIC))
    if magic != _ARRAY_MAGIC:
        raise PictureUnreadable(
            f"the picture cannot be read: the file starts with {magic!r}, expected {_ARRAY_MAGIC!r}"
        )
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, SyntaxError, MemoryError) as error:
        raise PictureUnreadable(
            f"the picture cannot be read: its {path.stat().st_size:,} bytes are not a whole array "
            "of numbers"
        ) from error
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.dtype.kind != "f":
        raise PictureUnreadable(
            f"the array is {array.dtype}{list(array.shape)}, "
            "expected floats [height, width, 3 or 4] from 0 to 1"
        )
    non_finite_count = int(array.size - np.isfinite(array).sum())
    if non_finite_count:
        raise PictureUnreadable(f"{non_finite_count:,} of {array.size:,} values are not finite")
    if array.size and array.max() > _MAX_FLOAT_VALUE:
        raise PictureUnreadable(f"values up to {array.max():g}, expected 0 to 1")
    return np.asarray(np.clip(array[..., :3], 0, 1), np.float64)


def _composite_picture_over_black(picture: np.ndarray) -> np.ndarray:
    """Composite an 8-bit image, grey or RGB, with or without straight alpha, over black."""
    values = picture.astype(np.float64) / 255
    if values.shape[2] in (2, 4):
        values = values[..., :-1] * values[..., -1:]
    return np.array(np.broadcast_to(values, (*values.shape[:2], 3)))


def decode_png(raw: bytes) -> np.ndarray:
    """Decode an 8-bit PNG, without palette or interlacing, to uint8 [h, w, c]."""
    if raw[:8] != _PNG_MAGIC:
        raise PictureUnreadable(f"the picture is not a PNG, but starts with {raw[:8]!r}")
    chunks: dict[bytes, bytes] = {}
    offset = 8
    while offset + 8 <= len(raw):
        length, kind = struct.unpack_from(">I4s", raw, offset)
        chunks[kind] = chunks.get(kind, b"") + raw[offset + 8 : offset + 8 + length]
        offset += length + 12
    if len(chunks.get(b"IHDR", b"")) != 13:
        raise PictureUnreadable("the PNG is cut or damaged: it has no whole IHDR chunk")
    width, height, depth, color, _, _, interlace = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    if depth != 8 or color not in _CHANNELS_BY_COLOR_TYPE or interlace:
        raise PictureUnreadable(
            f"the PNG has depth {depth}, colour type {color}, interlace {interlace}; expected "
            "8 bits of grey or RGB, with or without alpha, without palette, not interlaced"
        )
    size = width * _CHANNELS_BY_COLOR_TYPE[color]
    if (size + 1) * height > _MAX_BYTES:
        raise PictureUnreadable(
            f"the picture of {width}×{height} pixels takes {(size + 1) * height:,} bytes, "
            f"expected at most {_MAX_BYTES:,}"
        )
    inflated_bytes = _inflate(chunks.get(b"IDAT", b""), (size + 1) * height)
    lines = np.frombuffer(inflated_bytes, np.uint8).reshape(height, size + 1)
    return _undo_filter(lines, _CHANNELS_BY_COLOR_TYPE[color]).reshape(
        height, width, _CHANNELS_BY_COLOR_TYPE[color]
    )


def _inflate(data: bytes, size: int) -> bytes:
    """Decompress ``size`` bytes of a PNG's pixels."""
    try:
        inflated_bytes = zlib.decompressobj().decompress(data, max(size, 1))
    except zlib.error as error:
        raise PictureUnreadable("the PNG is damaged: its pixels cannot be decompressed") from error
    if len(inflated_bytes) != size or not size:
        raise PictureUnreadable(
            f"the PNG is cut or damaged: it holds {len(inflated_bytes):,} bytes of pixels, "
            f"expected {size:,}"
        )
    return inflated_bytes


def _undo_filter(lines: np.ndarray, step: int) -> np.ndarray:
    """Undo the filters of PNG lines; the first byte of each line is its filter type."""
    result = np.empty((len(lines), lines.shape[1] - 1), np.uint8)
    previous_line = np.zeros(lines.shape[1] - 1, np.uint8)
    for y, (method, line) in enumerate(zip(lines[:, 0].tolist(), lines[:, 1:], strict=True)):
        if method == 0:
            result[y] = line
        elif method == 1:  # the difference from the pixel before; sums of uint8 are modulo 256
            result[y] = np.cumsum(line.reshape(-1, step), axis=0, dtype=np.uint8).ravel()
        elif method == 2:
            result[y] = line + previous_line
        elif method in (3, 4):
            result[y] = _undo_prediction(method, line, previous_line, step)
        else:
            raise PictureUnreadable(f"a PNG line has filter type {method}, expected 0 to 4")
        previous_line = result[y]
    return result


def _undo_prediction(
    method: int, line: np.ndarray, previous_line: np.ndarray, step: int
) -> list[int]:
    """Undo the filter 3 (mean) or 4 (Paeth) of a line, which needs each pixel for the next."""
    current_line, line_above = [0] * step, [0] * step + previous_line.tolist()
    for i, difference in enumerate(line.tolist()):
        left_value, upper_value, upper_left = current_line[i], line_above[i + step], line_above[i]
        if method == 3:
            predicted_value = (left_value + upper_value) // 2
        else:
            paeth_estimate = left_value + upper_value - upper_left
            predicted_value = min(
                (left_value, upper_value, upper_left), key=lambda value: abs(paeth_estimate - value)
            )
        current_line.append((difference + predicted_value) & 255)
    return current_line[step:]


def encode_png(picture: np.ndarray) -> bytes:
    """Encode floats [h, w, 3] in [0, 1] as an 8-bit RGB PNG."""
    values = np.rint(np.clip(np.nan_to_num(picture), 0, 1) * 255).astype(np.uint8)
    height, width = values.shape[:2]
    lines = np.concatenate([np.zeros((height, 1), np.uint8), values.reshape(height, -1)], axis=1)
    header_data = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header_data), (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b""))
    return _PNG_MAGIC + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )

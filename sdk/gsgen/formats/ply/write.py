"""Writes splats and point clouds as PLY files."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import BinaryIO, Final, Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.formats.ply.header import (
    ANTIALIASED_COMMENT,
    COLOR_SPACE,
    PLY_ENCODINGS,
    Encoding,
    up_comment,
)
from gsgen.formats.ply.layout import COLORS, XYZ, splat_names
from gsgen.formats.ply.values import require_cloud, require_splats
from gsgen.formats.shared.errors import ValueInvalid, quoted
from gsgen.formats.shared.files import FilePath, naming, replace_file
from gsgen.formats.shared.origins import in_file_coordinates
from gsgen.formats.shared.splats import DEFAULT_UP, PointCloud, Splats

CHUNK_ROWS = 1 << 12
_MAX_SH_BYTES: Final = 1 << 28  # of SH coefficients, at most, whose rows PlyFrames keeps
_EMPTY_HIGHER_SH: Final = np.empty((0, 1, 3), np.float32)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Properties that stand side by side in a file, and their numbers.

    Attributes:
        names: The names of the properties.
        code: The type of each of them, as NumPy writes it.
        values: A row for each splat or point, which may be an array of several dimensions.
    """

    names: Sequence[str]
    code: Literal["f4", "f8", "u1"]
    values: Float[np.ndarray, "n ..."]


def write_ply(
    path: FilePath, content: Splats | PointCloud, *, format: Encoding = "binary_little_endian"
) -> None:
    """Write splats or coloured points to ``path`` as a PLY file.

    Splats are kept bit for bit; positions with an origin become doubles. The colours of a point cloud are written as bytes, which other
    programs expect, with an error of at most 1/510. The file is written completely or not at
    all.

    Raises:
        ValueInvalid: ``content`` is empty or holds values that cannot be drawn, or
            ``format`` is unknown.
        FileUnwritable: The file cannot be written at ``path``.
    """
    with naming(path):
        if format not in PLY_ENCODINGS:
            raise ValueInvalid(
                quoted(str(format)), where="format", expected=", ".join(PLY_ENCODINGS)
            )
        if isinstance(content, Splats):
            require_splats(content)
            blocks = _splat_blocks(content)
        else:
            require_cloud(content)
            blocks = _point_blocks(content)
    with replace_file(path) as file:
        flags = content if isinstance(content, Splats) else None
        file.write(_header(blocks, len(content), format, flags))
        _write_rows(file, blocks, format)
        file.write(_color_space_row(flags, format))


def write_ply_parts(path: FilePath, parts: Iterable[Splats], count: int) -> None:
    """Write ``count`` splats as a binary PLY file; the parts have equal SH degree and flags."""
    encoding: Encoding = "binary_little_endian"
    last_row = b""
    with replace_file(path) as file:
        for index, part in enumerate(parts):
            require_splats(part)
            blocks = _splat_blocks(part)
            if index == 0:
                file.write(_header(blocks, count, encoding, part))
                last_row = _color_space_row(part, encoding)
            _write_rows(file, blocks, encoding)
        file.write(last_row)


@final
class PlyFrames:
    """Writes the splats of successive frames as binary PLY files, each as ``write_ply`` does.

    Most generators move Gaussians that keep their colours, four fifths of a file at SH degree 3.
    The rows of the last file stay in memory: where the next frame has the very same array of SH
    coefficients, which must not have changed meanwhile, the other properties alone are checked and
    replaced.
    """

    def __init__(self) -> None:
        self._sh = _EMPTY_HIGHER_SH
        self._rows: np.ndarray = np.empty(0, np.uint8)

    def write(self, path: FilePath, splats: Splats) -> None:
        """Write a frame's splats to ``path``; see :func:`write_ply` for the errors."""
        if splats.sh.nbytes > _MAX_SH_BYTES:
            write_ply(path, splats)
            return
        encoding: Encoding = "binary_little_endian"
        blocks = _splat_blocks(splats)
        does_keep_colors = splats.sh is self._sh and self._rows.dtype == _row_type(blocks, encoding)
        with naming(path):
            require_splats(splats, checked_fields=("sh",) if does_keep_colors else ())
        if not does_keep_colors:
            self._sh = _EMPTY_HIGHER_SH  # until the rows hold them
            self._rows = np.empty(len(splats), _row_type(blocks, encoding))
        changed = [
            block for block in blocks if not (does_keep_colors and block.names[0].startswith("f_"))
        ]
        with replace_file(path) as file:
            file.write(_header(blocks, len(splats), encoding, splats))
            for start in range(0, len(splats), CHUNK_ROWS):
                rows = slice(start, start + CHUNK_ROWS)
                chunk = self._rows[rows]
                for block in changed:
                    chunk[block.names[0]] = block.values[rows]
                file.write(chunk.view(np.uint8).data)
            file.write(_color_space_row(splats, encoding))
        self._sh = splats.sh


def _position_block(content: Splats | PointCloud) -> _Block:
    """Return the positions: doubles in the coordinates of the file where they have an origin."""
    if any(content.origin):
        return _Block(XYZ, "f8", in_file_coordinates(content))
    return _Block(XYZ, "f4", content.position)


def _splat_blocks(splats: Splats) -> list[_Block]:
    names = iter(splat_names(splats.degree)[len(XYZ) :])
    arrays = (
        splats.sh[:, 0],
        splats.sh[:, 1:].transpose(0, 2, 1),  # all of red, then green, then blue
        splats.logit_opacity,
        splats.log_scale,
        splats.rotation,
    )
    blocks = [
        _Block(list(islice(names, math.prod(array.shape[1:]))), "f4", array)
        for array in arrays
        if array.size  # degree 0 has no further harmonics
    ]
    return [_position_block(splats), *blocks]


def _point_blocks(cloud: PointCloud) -> list[_Block]:
    color = np.rint(cloud.color * np.float32(255))
    return [_position_block(cloud), _Block(COLORS[0], "u1", color)]


def _header(
    blocks: Sequence[_Block], count: int, encoding: Encoding, flags: Splats | None
) -> bytes:
    """Return the header of a PLY file; splats declare what differs from 3DGS training."""
    type_names = {"f4": "float", "f8": "double", "u1": "uchar"}
    lines = ["ply", f"format {encoding} 1.0"]
    if flags is not None and flags.antialiased:
        lines.append(ANTIALIASED_COMMENT)
    if flags is not None and flags.up != DEFAULT_UP:
        lines.append(up_comment(flags.up))
    lines.append(f"element vertex {count}")
    lines += [
        f"property {type_names[block.code]} {name}" for block in blocks for name in block.names
    ]
    if flags is not None and flags.color_space == "linear":
        lines += [f"element {COLOR_SPACE} 1", f"property uchar {COLOR_SPACE}"]
    return "\n".join([*lines, "end_header\n"]).encode("ascii")


def _color_space_row(flags: Splats | None, encoding: Encoding) -> bytes:
    """Return the row of the element that declares linear colours, as SHARP writes it."""
    if flags is None or flags.color_space == "srgb":
        return b""
    return b"1\n" if encoding == "ascii" else b"\x01"


def _row_type(blocks: Sequence[_Block], encoding: Encoding) -> np.dtype[np.void]:
    """Return the type of a binary row: a field for each block, with the block's first name."""
    order = ">" if encoding == "binary_big_endian" else "<"
    return np.dtype(
        [(block.names[0], order + block.code, block.values.shape[1:]) for block in blocks]
    )


def _write_rows(file: BinaryIO, blocks: Sequence[_Block], encoding: Encoding) -> None:
    if encoding == "ascii":
        _write_lines(file, blocks)
        return
    count = len(blocks[0].values)
    # Used for all chunks: the system's clearing of new memory takes as long as copying.
    rows = np.empty(min(count, CHUNK_ROWS), _row_type(blocks, encoding))
    for start in range(0, count, CHUNK_ROWS):
        chunk = rows[: count - start]
        for block in blocks:
            chunk[block.names[0]] = block.values[start : start + CHUNK_ROWS]
        file.write(chunk.view(np.uint8).data)


def _write_lines(file: BinaryIO, blocks: Sequence[_Block]) -> None:
    # Nine digits identify every float32, seventeen every double.
    formats = {"f4": "%.9g", "f8": "%.17g", "u1": "%d"}
    digits = [formats[block.code] for block in blocks for _ in block.names]
    for start in range(0, len(blocks[0].values), CHUNK_ROWS):
        parts = [block.values[start : start + CHUNK_ROWS] for block in blocks]
        np.savetxt(file, np.concatenate([p.reshape(len(p), -1) for p in parts], axis=1), fmt=digits)

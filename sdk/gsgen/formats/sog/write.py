"""Writes SOG files, version 2: splats in lossless WebP images, zipped or beside meta.json."""

import hashlib
import json
import math
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, final

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8, UInt16, UInt32

from gsgen.contract.file_kinds.names import META_FILE
from gsgen.formats.shared.errors import NotSupported
from gsgen.formats.shared.files import FilePath, naming, replace_file
from gsgen.formats.shared.morton import grid_codes, grid_order
from gsgen.formats.shared.quantities import rounded, sigmoid, to_bytes, unit, without_largest
from gsgen.formats.shared.splat_values import require_drawable
from gsgen.formats.shared.splats import Splats
from gsgen.formats.sog.codebook import make_codebook, nearest_codes
from gsgen.formats.sog.image import encode_image
from gsgen.formats.sog.meta import (
    ANTIALIASED,
    MAX_PALETTE_SIZE,
    PALETTE_WIDTH,
    QUATERNION_TAG,
    is_meta,
    is_streamed_meta,
)
from gsgen.formats.sog.palette import make_palette, nearest_entries, training_step
from gsgen.formats.sog.streamed_write import write_levels

__all__ = ["SplatParts", "sog_files", "sog_order", "write_sog", "write_sog_parts"]

_MAX_SH_DEGREE: Final = 3
_MAX_UINT16_LEVEL: Final = 65535
_FLAT_LOG_SCALE: Final = -20.0  # the logarithm of the scale of a flat axis, whose own is -inf
_CHUNK_ROWS: Final = 1 << 18
_SMALL_SPLAT_COUNT: Final = 1 << 10  # splats of a scene whose palette has an entry for each
_MAX_IMAGE_WIDTH: Final = 16383  # pixels of a side, the limit of WebP

Rows = UInt32[np.ndarray, " m"]


class SplatParts(Protocol):
    """Splats that are read in parts; each iteration yields the same parts again."""

    @property
    def antialiased(self) -> bool:
        """Whether training used the filter of Mip-Splatting."""
        ...

    @property
    def degree(self) -> int:
        """The SH degree of the splats."""
        ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Splats]: ...


@final
@dataclass(frozen=True, slots=True)
class InMemory:
    """Splats whose arrays are all in memory, for :func:`write_sog_parts`."""

    splats: Splats

    @property
    def antialiased(self) -> bool:
        return self.splats.antialiased

    @property
    def degree(self) -> int:
        return self.splats.degree

    def __len__(self) -> int:
        return len(self.splats)

    def __iter__(self) -> Iterator[Splats]:
        yield self.splats


def write_sog(path: FilePath, splats: Splats) -> None:
    """Write ``splats`` as a SOG archive, or as separate files if ``path`` is a meta.json.

    A lod-meta.json gets levels of detail in SOG files beside it (streamed SOG). Splats are written
    in the order of ``sog_order``. The bytes depend on the splats alone.

    Raises:
        ValueInvalid: ``splats`` is empty or holds values that cannot be drawn.
        NotSupported: Harmonics are above degree 3, there are more splats than an image holds,
            or Pillow is not installed.
        FileUnwritable: A file cannot be written.
    """
    with naming(path):
        require_drawable(splats)
    if not is_streamed_meta(path):
        write_sog_parts(path, InMemory(splats))
        return
    with naming(path):  # before the first folder is made
        _require_encodable_splats(InMemory(splats))
    nearest_codes = grid_codes(_stored_positions(splats.position)[0])
    order = np.argsort(nearest_codes, kind="stable")

    def write(file: Path, part: Splats) -> None:
        write_sog_parts(file, InMemory(part), is_sorted=True)

    write_levels(path, splats[order], nearest_codes[order], write)


def write_sog_parts(path: FilePath, splats: SplatParts, *, is_sorted: bool = False) -> None:
    """Write valid splats as a SOG file, with one array of the splats in memory at a time.

    SH coefficients above degree 0 are not held in memory: a sample chooses the palette. With
    ``is_sorted``, the splats keep their order.
    """
    with naming(path):
        files = sog_files(splats, is_sorted=is_sorted)
    if is_meta(path):
        for name, content in files.items():  # meta.json is the last
            with replace_file(Path(path).with_name(name) if name != META_FILE else path) as file:
                file.write(content)
        return
    with replace_file(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)


def _require_encodable_splats(splats: SplatParts) -> None:
    """Raise NotSupported for harmonics above degree 3, and more splats than an image holds."""
    if splats.degree > _MAX_SH_DEGREE:
        raise NotSupported(
            f"the splats have SH degree {splats.degree}",
            expected=f"degree {_MAX_SH_DEGREE} or less",
        )
    if len(splats) > _MAX_IMAGE_WIDTH**2:
        raise NotSupported(
            f"the scene has {len(splats)} splats",
            expected=f"{_MAX_IMAGE_WIDTH**2} or fewer, the pixels of an image",
            hint="write several files, each of a box of the scene",
        )


def sog_order(splats: Splats) -> Int64[np.ndarray, " n"]:
    """Return the row order in which ``write_sog`` writes splats: Morton order of positions."""
    return grid_order(_stored_positions(splats.position)[0])


@final
class _ImageWriter:
    """The images of a SOG file, whose pixels follow the splats in Morton order.

    Attributes:
        files: The content of each image, by name.
        order: The splat of each pixel.

    Args:
        order: See above.
        has_digests: Whether names end with the first 8 digits of the content's SHA-256.
    """

    def __init__(self, order: Int64[np.ndarray, " n"], *, has_digests: bool) -> None:
        self.files: dict[str, bytes] = {}
        self._has_digests = has_digests
        self.order = order.astype(np.uint32)  # half the memory

    def add(self, name: str, pixels: Callable[[Rows], UInt8[np.ndarray, "m c"]]) -> str:
        """Encode a SOG image with one pixel per splat; missing channels are 255."""
        table = np.full((len(self.order), 4), 255, np.uint8)
        for start in range(0, len(table), _CHUNK_ROWS):
            part = pixels(self.order[start : start + _CHUNK_ROWS])
            table[start : start + _CHUNK_ROWS, : part.shape[1]] = part
        return self.keep(name, encode_image(table))

    def keep(self, name: str, content: bytes) -> str:
        """Keep an encoded image; return the name of its file."""
        if self._has_digests:
            digest = hashlib.sha256(content).hexdigest()[:8]
            name = f"{Path(name).stem}-{digest}{Path(name).suffix}"
        self.files[name] = content
        return name


def _concatenate_column(
    splats: SplatParts, select: Callable[[Splats], Float32[np.ndarray, "m ..."]]
) -> Float32[np.ndarray, "n ..."]:
    """Concatenate the arrays that a function selects from each part of the splats."""
    table = np.empty(0, np.float32)
    end = 0
    for part in splats:
        array = select(part)
        if not end:
            table = np.empty((len(splats), *array.shape[1:]), np.float32)
        table[end : end + len(array)] = array
        end += len(array)
    return table


def _higher_sh_batches(splats: SplatParts) -> Iterator[Float32[np.ndarray, "m d"]]:
    """Yield SH coefficients above degree 0 in batches of 2¹⁸ splats.

    The batches do not depend on the sizes of the parts, so that rounding does not either.
    """
    parts: list[Float32[np.ndarray, "m d"]] = []
    missing = _CHUNK_ROWS
    for part in splats:
        rows = part.sh[:, 1:].reshape(len(part), -1)
        while len(rows) >= missing:
            yield np.concatenate([*parts, rows[:missing]])
            parts, rows, missing = [], rows[missing:], _CHUNK_ROWS
        if len(rows):
            parts.append(rows)
            missing -= len(rows)
    if parts:
        yield np.concatenate(parts)


def sog_files(
    splats: SplatParts, *, is_sorted: bool = False, has_digests: bool = False
) -> dict[str, bytes]:
    """Return the content of each file of a SOG by its name, meta.json last.

    Args:
        splats: Valid splats.
        is_sorted: Whether they keep their order.
        has_digests: Whether names of images end with the first 8 digits of their SHA-256, so that
            caches can keep them for ever.

    Raises:
        NotSupported: As :func:`write_sog`.
    """
    _require_encodable_splats(splats)
    steps, low, high = _stored_positions(_concatenate_column(splats, lambda part: part.position))
    order = np.arange(len(steps)) if is_sorted else grid_order(steps)
    images = _ImageWriter(order, has_digests=has_digests)
    meta: dict[str, Any] = {"version": 2, "count": len(splats)}
    if splats.antialiased:
        meta["model"] = ANTIALIASED
    meta["means"] = _add_position_images(steps, images) | {
        "mins": low.tolist(),
        "maxs": high.tolist(),
    }
    del steps
    meta["scales"] = _add_scales(
        _finite_scales(_concatenate_column(splats, lambda part: part.log_scale)), images
    )
    meta["quats"] = _add_rotations(_concatenate_column(splats, lambda part: part.rotation), images)
    logit_opacity = _concatenate_column(splats, lambda part: part.logit_opacity)
    meta["sh0"] = _add_colors(
        _concatenate_column(splats, lambda part: part.sh[:, 0]), logit_opacity, images
    )
    del logit_opacity
    if splats.degree:
        meta["shN"] = _add_palette(splats, images)
    return images.files | {META_FILE: json.dumps(meta, separators=(",", ":")).encode()}


def _add_position_images(steps: Int64[np.ndarray, "n 3"], images: _ImageWriter) -> dict[str, Any]:
    """Encode positions as two SOG images, of low and high bytes; return their JSON description."""
    low = images.add("means_l.webp", lambda rows: (steps[rows] & 255).astype(np.uint8))
    high = images.add("means_u.webp", lambda rows: (steps[rows] >> 8).astype(np.uint8))
    return {"files": [low, high]}


def _add_rotations(rotation: Float32[np.ndarray, "n 4"], images: _ImageWriter) -> dict[str, Any]:
    """Encode rotations as an image of a SOG file; return its JSON description."""
    return {"files": [images.add("quats.webp", lambda rows: _packed_rotations(rotation[rows]))]}


def _add_scales(log_scale: Float32[np.ndarray, "n 3"], images: _ImageWriter) -> dict[str, Any]:
    """Encode scales as an image of a SOG file; return its JSON description."""
    code_values = make_codebook(log_scale)
    name = images.add("scales.webp", lambda rows: nearest_codes(log_scale[rows], code_values))
    return {"codebook": _numbers(code_values), "files": [name]}


def _add_colors(
    color: Float32[np.ndarray, "n 3"],
    logit_opacity: Float32[np.ndarray, " n"],
    images: _ImageWriter,
) -> dict[str, Any]:
    """Encode colours and opacities as an image of a SOG file; return its JSON description."""
    code_values = make_codebook(color)

    def color_pixels(rows: Rows) -> UInt8[np.ndarray, "m 4"]:
        alpha = to_bytes(sigmoid(logit_opacity[rows]) * np.float32(255))
        return np.column_stack([nearest_codes(color[rows], code_values), alpha])

    return {"codebook": _numbers(code_values), "files": [images.add("sh0.webp", color_pixels)]}


def _stored_positions(
    position: Float32[np.ndarray, "n 3"],
) -> tuple[Int64[np.ndarray, "n 3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return positions, companded by sgn(x) ln(1 + |x|), as 16-bit steps, and their range."""
    ends = np.stack([position.min(axis=0), position.max(axis=0)]).astype(np.float64)
    low, high = np.sign(ends) * np.log1p(np.abs(ends))
    size = np.where(high > low, high - low, 1.0)
    steps = np.empty((len(position), 3), np.uint16)
    for start in range(0, len(position), _CHUNK_ROWS):
        part = position[start : start + _CHUNK_ROWS].astype(np.float64)
        stored = np.sign(part) * np.log1p(np.abs(part))
        steps[start : start + _CHUNK_ROWS] = rounded(
            (stored - low) / size * _MAX_UINT16_LEVEL, 0, _MAX_UINT16_LEVEL
        )
    return steps, low, high


def _finite_scales(log_scale: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Replace log scales of -inf, which JSON lacks, by a very small scale."""
    flat_axis_mask = np.isneginf(log_scale)
    if not flat_axis_mask.any():
        return log_scale
    smallest_scale = np.min(log_scale, initial=_FLAT_LOG_SCALE, where=~flat_axis_mask)
    return np.where(flat_axis_mask, np.float32(smallest_scale), log_scale)


def _packed_rotations(rotation: Float32[np.ndarray, "m 4"]) -> UInt8[np.ndarray, "m 4"]:
    largest, smaller = without_largest(unit(rotation))
    return np.column_stack(
        [
            to_bytes((smaller * math.sqrt(2) + 1) * 127.5),
            (QUATERNION_TAG + largest).astype(np.uint8),
        ]
    )


def _add_palette(splats: SplatParts, images: _ImageWriter) -> dict[str, Any]:
    """Encode the SH palette and the splats' palette indices as SOG images; return their JSON.

    The palette is rounded to its codebook before each splat takes the nearest entry.
    """
    size = (splats.degree + 1) ** 2 - 1
    sample = _training_rows(splats)
    palette = make_palette(sample, _palette_size(len(splats)))
    members = np.bincount(nearest_entries(sample, palette), minlength=len(palette))
    del sample
    code_values = make_codebook(palette, np.repeat(members, palette.shape[1]))
    palette_codes = nearest_codes(palette, code_values)
    labels = _labels(splats, code_values[palette_codes])
    width = PALETTE_WIDTH * size
    pixels = np.full((-(-len(palette) // PALETTE_WIDTH) * width, 4), 255, np.uint8)
    pixels[: palette_codes.size // 3, :3] = palette_codes.reshape(-1, 3)
    centroids = images.keep("shN_centroids.webp", encode_image(pixels, width))

    def label_pixels(rows: Rows) -> UInt8[np.ndarray, "m 3"]:
        label = labels[rows]
        return np.stack([label & 255, label >> 8, 0 * label], axis=1).astype(np.uint8)

    return {
        "count": len(palette),
        "bands": splats.degree,
        "codebook": _numbers(code_values),
        "files": [centroids, images.add("shN_labels.webp", label_pixels)],
    }


def _training_rows(splats: SplatParts) -> Float32[np.ndarray, "m d"]:
    """Return the SH coefficients above degree 0 of evenly spaced splats, to train the palette."""
    step = training_step(len(splats))
    first, samples = 0, []  # the next row of the sample, counted from the start of the batch
    for rows in _higher_sh_batches(splats):
        samples.append(rows[first::step].copy())
        first = (first - len(rows)) % step
    return np.concatenate(samples)


def _labels(splats: SplatParts, palette: Float32[np.ndarray, "p d"]) -> UInt16[np.ndarray, " n"]:
    """Return the index of each splat's entry in the SH palette."""
    batches = _higher_sh_batches(splats)
    return np.concatenate([nearest_entries(rows, palette).astype(np.uint16) for rows in batches])


def _palette_size(count: int) -> int:
    """Return the size of the SH palette of a scene with ``count`` splats.

    A small scene has an entry for each splat. Otherwise ``count`` is rounded down to a power of
    two, of which a sixteenth is added, up to the limit of the format.
    """
    if count <= _SMALL_SPLAT_COUNT:
        return count
    size = 1 << (count.bit_length() - 1)
    return min(MAX_PALETTE_SIZE, count, size + size // 16)  # rows of 64 stay full


def _numbers(code_values: Float32[np.ndarray, "256"]) -> list[float]:
    """Return the shortest decimal numbers that parse to given float32 numbers."""
    return [float(str(number)) for number in code_values]

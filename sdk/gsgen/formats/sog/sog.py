"""Reads SOG files, versions 1 and 2: splats in lossless WebP images, zipped or beside meta.json.

The format is that of PlayCanvas (playcanvas/splat-transform, "SOG"). Pillow reads the images.
"""

import io
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from gsgen.contract.file_kinds.names import META_FILE
from gsgen.formats.shared.bytes import DOWNLOAD_HINT, MAX_BYTES, MAX_INFLATION
from gsgen.formats.shared.errors import (
    FileTruncated,
    HeaderMalformed,
    PropertyMissing,
    SizeExceeded,
    quoted,
)
from gsgen.formats.shared.files import FilePath, file_beside, naming, open_file, stream_size
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.npz_arrays import ZIP_MAGIC, unpacking
from gsgen.formats.shared.quantities import logit, quaternions_from_largest, unit
from gsgen.formats.shared.splat_values import drawable
from gsgen.formats.shared.splats import SH_COUNTS, Splats
from gsgen.formats.sog.image import Image, decode_image, image_size, most_pixels
from gsgen.formats.sog.meta import (
    MAX_PALETTE_SIZE,
    PALETTE_WIDTH,
    QUATERNION_TAG,
    Meta,
    is_meta,
    is_streamed_meta,
    palette_of_image,
    parse_object,
)
from gsgen.formats.sog.streamed import STREAMED_KEYS, is_streamed, read_levels

__all__ = ["decode_sog", "read_sog"]

MAX_META: Final = 1 << 22
_MAX_PIXELS_PER_BYTE = 1024  # splats a byte of positions; real data have fewer
_BYTES_PER_PIXEL = 8  # lossless WebP of noise takes little more than four
_MAX_DEGREE = 3
_BYTES_PER_SPLAT = 236  # the memory of a splat of degree 3

FetchFile = Callable[[str, int], bytes]
"""Returns the content of a file; raises if it has more bytes than the second argument."""


def read_sog(path: FilePath, *, max_bytes: int = MAX_BYTES, drop_invalid: bool = False) -> Splats:
    """Read the SOG file at ``path``: a zip archive, or the meta.json of an unpacked archive.

    Args:
        path: The file.
        max_bytes: The limit of the memory of all splats, in bytes.
        drop_invalid: Drop rows that cannot be drawn, and warn about them.

    Raises:
        FileUnreadable: A file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not a SOG.
        NotSupported: The version is not 1 or 2, or Pillow is not installed.
        HeaderMalformed: meta.json is not JSON, or a value of it is missing or invalid.
        PropertyMissing: The archive lacks meta.json, or an image that it names.
        FileTruncated: An image has too few pixels.
        ArchiveDamaged: The archive or an image cannot be unpacked.
        SizeExceeded: The splats need more than ``max_bytes``.
        ValueInvalid: The file has no splats, or one that cannot be drawn.
    """
    with naming(path), np.errstate(all="ignore"):
        splats, unused = _read(path, max_bytes)
        warn_unused(path, list(dict.fromkeys(unused)))
        return drawable(splats, path, drop_invalid=drop_invalid)


def decode_sog(name: str, fetch: FetchFile, *, max_bytes: int = MAX_BYTES) -> Splats:
    """Decode a SOG whose files come from elsewhere than a folder: a zip archive, or a meta.json.

    Args:
        name: Of the file.
        fetch: Returns the content of it, and of the images that it names.
        max_bytes: The limit of the memory of all splats, in bytes.

    Raises:
        FormatError: As for :func:`read_sog`.
    """
    content = fetch(name, max_bytes)

    def fetch_next(file: str, limit: int) -> bytes:
        return content if file == name else fetch(file, limit)

    with naming(name), np.errstate(all="ignore"):
        if content.startswith(ZIP_MAGIC):
            with unpacking("archive"), zipfile.ZipFile(io.BytesIO(content)) as archive:
                splats, _ = _decode(
                    _fetch_from_archive(archive, len(content)), META_FILE, max_bytes
                )
        else:
            splats, _ = _decode(fetch_next, name, max_bytes)
        return drawable(splats, name, drop_invalid=False)


def _read(path: FilePath, max_bytes: int) -> tuple[Splats, list[str]]:
    """Return the unchecked splats of a SOG, and the names of its parts that were not used."""
    with open_file(path) as file:
        if file.read(len(ZIP_MAGIC)) != ZIP_MAGIC:
            return _read_unpacked(path, max_bytes)
        with unpacking("archive"), zipfile.ZipFile(file) as archive:
            names = {info.filename for info in archive.infolist() if not info.is_dir()}
            fetch = _fetch_from_archive(archive, stream_size(file))

            def fetch_named(name: str, limit: int) -> bytes:
                names.difference_update([entry for entry in names if _base_name(entry) == name])
                return fetch(name, limit)

            splats, unused = _decode(fetch_named, META_FILE, max_bytes)
            return splats, unused + [f"file {quoted(name)}" for name in sorted(names)]


def _base_name(name: str) -> str:
    return name.rpartition("/")[2]


def _read_unpacked(path: FilePath, max_bytes: int) -> tuple[Splats, list[str]]:
    """Read an unpacked SOG by its meta.json, or streamed SOG files by their lod-meta.json."""
    fetch, name = _fetch_from_folder(path), Path(path).name
    data = parse_object(fetch(name, MAX_META))
    if not is_streamed(data):
        return _decode(fetch, name, max_bytes)
    unused = [f"key {key}" for key in data if key not in STREAMED_KEYS]

    def read_part(part: str, limit: int) -> Splats:
        file = Path(path).parent / part
        if not file.resolve().is_relative_to(Path(path).parent.resolve()):
            raise HeaderMalformed(quoted(part), where=name, expected="a file below its folder")
        with open_file(file) as stream:
            is_streamed_too = stream.read(len(ZIP_MAGIC)) != ZIP_MAGIC and is_streamed(
                parse_object(_fetch_from_folder(file)(file.name, MAX_META))
            )
        if is_streamed_too:
            raise HeaderMalformed(quoted(part), where=name, expected="the meta.json of one SOG")
        with naming(file):
            splats, unused_parts = _read(file, max(limit, 0))
            unused.extend(unused_parts)
            return drawable(splats, file, drop_invalid=False)

    return read_levels(data, read_part, max_bytes), unused


def written_bytes(path: FilePath) -> int:
    """Return the size of a SOG in bytes, with all files that its meta.json or lod-meta.json names."""
    size = Path(path).stat().st_size
    if is_streamed_meta(path):
        files = parse_object(Path(path).read_bytes())["filenames"]
        return size + sum(written_bytes(Path(path).parent / file) for file in files)
    if not is_meta(path):
        return size
    with naming(path):
        names = Meta.parse(Path(path).read_bytes()).all_files()
    return size + sum(Path(path).with_name(name).stat().st_size for name in names)


def _fetch_from_archive(archive: zipfile.ZipFile, size: int) -> FetchFile:
    names = set(archive.namelist())
    meta_file_names = [name for name in names if _base_name(name) == META_FILE]
    # Archives made of a folder hold its name, too.
    folder = min(meta_file_names, key=len).removesuffix(META_FILE) if meta_file_names else ""

    def fetch(name: str, limit: int) -> bytes:
        name = folder + name
        if name not in names:
            raise PropertyMissing(f"the archive holds no file {quoted(name)}", where="archive")
        most = min(limit, size * MAX_INFLATION)
        with unpacking(f"file {quoted(name)}"), archive.open(name) as stream:
            return _require_size_limit(stream.read(most + 1), most, name)

    return fetch


def _fetch_from_folder(path: FilePath) -> FetchFile:
    from gsgen.contract.inputs.addresses import is_plain_location

    own_name = Path(path).name

    def fetch(name: str, limit: int) -> bytes:
        if Path(name).name != name or not is_plain_location(name):
            raise HeaderMalformed(
                quoted(name), where=META_FILE, expected="the name of a file in the same folder"
            )
        file_path = path if name == own_name else file_beside(path, name)
        with open_file(file_path) as file:
            most = min(limit, stream_size(file))
            return _require_size_limit(file.read(most + 1), most, name)

    return fetch


def _require_size_limit(content: bytes, limit: int, name: str) -> bytes:
    if len(content) > limit:
        raise SizeExceeded(
            f"the file has more than {limit} bytes",
            where=f"file {quoted(name)}",
            hint=DOWNLOAD_HINT,
        )
    return content


def _decode(fetch: FetchFile, name: str, max_bytes: int) -> tuple[Splats, list[str]]:
    meta = Meta.parse(fetch(name, MAX_META))
    count = meta.count
    if count * _BYTES_PER_SPLAT > max_bytes:
        raise SizeExceeded(
            f"the {count} splats take about {count * _BYTES_PER_SPLAT} bytes",
            expected=f"{max_bytes} bytes or fewer",
            hint="if you trust the file, read it with a larger max_bytes",
        )

    def fetch_image(file: str, pixels: int) -> bytes:
        return fetch(file, _BYTES_PER_PIXEL * most_pixels(pixels))

    means = [fetch_image(file, count) for file in meta.files("means", 2)]
    packed = sum(map(len, means))
    if count > packed * _MAX_PIXELS_PER_BYTE:
        raise FileTruncated(
            f"meta.json declares {count} splats, but their positions are {packed} bytes",
            where=f"{META_FILE}, count",
            expected=f"at most {packed * _MAX_PIXELS_PER_BYTE} splats, with the best compression",
            hint=DOWNLOAD_HINT,
        )
    low, high = (decode_image(image, count, "means") for image in means)

    def image(group: str) -> Image:
        (file,) = meta.files(group, 1)
        return decode_image(fetch_image(file, count), count, group)

    color = image("sh0")
    if meta.version == 1:  # the last channel holds logits
        decoded_color = meta.decode("sh0", color)
        constant, logit_opacity = decoded_color[:, :3], decoded_color[:, 3]
    else:
        constant = meta.decode("sh0", color[:, :3])
        logit_opacity = logit(np.arange(256) / 255)[color[:, 3]]
    splats = Splats(
        position=_positions(meta, low, high),
        rotation=_decode_rotations(image("quats")),
        log_scale=meta.decode("scales", image("scales")[:, :3]),
        logit_opacity=logit_opacity,
        sh=np.concatenate([constant[:, None], _decode_higher_sh_bands(meta, fetch_image)], axis=1),
        antialiased=meta.antialiased,
    )
    return splats, meta.unused()


def _positions(meta: Meta, low: Image, high: Image) -> Float32[np.ndarray, "n 3"]:
    fractions = (low[:, :3] | high[:, :3].astype(np.int64) << 8) / 65535
    least_values, most = meta.triple("means", "mins"), meta.triple("means", "maxs")
    stored = least_values * (1 - fractions) + most * fractions
    return np.asarray(np.sign(stored) * np.expm1(np.abs(stored)), np.float32)


def _decode_rotations(image: Image) -> Float32[np.ndarray, "n 4"]:
    """Decode quaternions from the pixels of a SOG image; an invalid tag gives the identity."""
    tag = image[:, 3].astype(np.int64) - QUATERNION_TAG
    smaller = (image[:, :3] / 127.5 - 1) * math.sqrt(0.5)
    rotation = unit(quaternions_from_largest(np.maximum(tag, 0), smaller))
    rotation[tag < 0] = (1, 0, 0, 0)
    return rotation


def _decode_higher_sh_bands(
    meta: Meta, fetch_image: Callable[[str, int], bytes]
) -> Float32[np.ndarray, "n k 3"]:
    """Return the SH coefficients above degree 0 of each splat, from the palette of a SOG file."""
    if not meta.has_palette:
        return np.empty((meta.count, 0, 3), np.float32)
    declared_palette = None if meta.version == 1 else meta.palette()
    centroids, labels = meta.files("shN", 2)
    content = fetch_image(centroids, MAX_PALETTE_SIZE * (SH_COUNTS[_MAX_DEGREE] - 1))
    size, degree = declared_palette or palette_of_image(*image_size(content, "shN"))
    higher_count = SH_COUNTS[degree] - 1
    height = -(-size // PALETTE_WIDTH)
    pixels = PALETTE_WIDTH * higher_count * height
    image = decode_image(content, pixels, "shN", PALETTE_WIDTH * higher_count)
    indices = decode_image(fetch_image(labels, meta.count), meta.count, "shN")
    label = indices[:, 0] | indices[:, 1].astype(np.int64) << 8
    if (label >= size).any():
        raise HeaderMalformed(
            f"a palette label is {int(label.max())}", where="shN", expected=f"0 to {size - 1}"
        )
    # Row y of the image holds palette entries 64 y to 64 y + 63, one after the other.
    entries = image[:, :3].reshape(height * PALETTE_WIDTH, higher_count, 3)
    return np.asarray(meta.decode("shN", entries)[label])

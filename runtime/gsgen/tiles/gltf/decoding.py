"""Reads the glTF content of tiles: splats by KHR_gaussian_splatting or drafts of it.

What only a header says is read without decoding, so that a listing of a tileset is quick.
"""

__all__ = ["ContentHeader", "SplatPrimitive", "decode_content", "read_header"]

import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.formats.glb.accessors import view_range
from gsgen.formats.glb.container import Container, object_member
from gsgen.formats.glb.glb import scene_primitives
from gsgen.formats.glb.splats import EXTENSION_NAME, is_splats, read_primitive
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splats import Splats
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.extensions import SPZ_EXTENSION
from gsgen.tiles.format.json_values import JsonDict, JsonObject
from gsgen.tiles.gltf.container import raise_as_fault

DRAFT_EXTENSIONS: Final = (
    "KHR_gaussian_splatting_compression_spz",
    "KHR_spz_gaussian_splats_compression",
)
"""Extensions of drafts that hold SPZ."""
DRAFT_ATTRIBUTES: Final = ("_ROTATION", "_SCALE")
MAX_SPLATS: Final = 1 << 26
MAX_DECODED_BYTES: Final = 2 << 30

_SPZ_HEADER = struct.Struct("<4sIIBB")
_SPZ_HEAD_BYTES = 512
_COEFFICIENT_PATTERN = re.compile(r"SH_DEGREE_(\d)_COEF_\d")
_DECODED_SPLAT_BYTES = 400  # bytes of a splat while it is decoded


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SplatPrimitive:
    """A glTF primitive of splats, as its JSON and SPZ header describe it.

    Attributes:
        location: JSON path.
        counts: Source → how many splats it says: ``POSITION``, other attributes, ``SPZ``.
        sh_degree: Of the harmonics.
        spz_version: None where it is not SPZ.
        drafts: Names of drafts that it uses.
        conforms: Faults of mode, kernel, colour space and the like, in words.
    """

    location: str
    counts: dict[str, int]
    sh_degree: int
    spz_version: int | None
    drafts: tuple[str, ...]
    conforms: tuple[str, ...]

    @property
    def count(self) -> int:
        """The number of splats, from the SPZ header or else from the positions."""
        return self.counts.get("SPZ", self.counts.get("POSITION", 0))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ContentHeader:
    """The metadata of a tile's glTF content: file size, splat primitives and extensions.

    Attributes:
        size: Bytes of the file.
        primitives: Its sets of splats.
        extensions_used: As declared.
        extensions_required: As declared.
    """

    size: int
    primitives: tuple[SplatPrimitive, ...]
    extensions_used: tuple[str, ...]
    extensions_required: tuple[str, ...]

    @property
    def splats(self) -> int:
        """The number of splats of all primitives of a tile's content."""
        return sum(primitive.count for primitive in self.primitives)

    @property
    def sh_degree(self) -> int:
        """The highest SH degree of a tile's content."""
        return max((primitive.sh_degree for primitive in self.primitives), default=0)


def read_header(container: Container, location: str, size: int) -> ContentHeader:
    """Read the glTF JSON and SPZ headers of a tile's content, without decoding splats."""
    with raise_as_fault(location, Fault.CONTENT):
        primitives = tuple(
            _read_primitive(container, primitive, where, location)
            for primitive, _, where in scene_primitives(container)
        )
        document = JsonObject(container.document, f"{location}, ", Fault.CONTENT)
        return ContentHeader(
            size=size,
            primitives=primitives,
            extensions_used=document.texts("extensionsUsed"),
            extensions_required=document.texts("extensionsRequired"),
        )


def _read_primitive(
    container: Container, primitive: JsonDict, where: str, location: str
) -> SplatPrimitive:
    attributes = object_member(primitive, "attributes", where)
    extensions = object_member(primitive, "extensions", where)
    extension = object_member(extensions, EXTENSION_NAME, where)
    packed = extensions | object_member(extension, "extensions", where)
    counts = {}
    for name, index in attributes.items():
        accessor = container.item("accessors", index, f"{where}.attributes.{name}")
        entry = JsonObject(accessor, f"{location}, accessors[{index}]", Fault.COUNTS)
        counts[str(name)] = entry.whole("count", most=MAX_SPLATS)
    degrees = [int(match[1]) for match in map(_COEFFICIENT_PATTERN.search, attributes) if match]
    degree, version = max(degrees, default=0), None
    for name in (SPZ_EXTENSION, *DRAFT_EXTENSIONS):
        if name in packed:
            extension_parent = object_member(packed, name, where)
            version, counts["SPZ"], degree = _spz_head(
                container, extension_parent, f"{location}, {where}"
            )
            break
    drafts: list[str] = [name for name in DRAFT_EXTENSIONS if name in packed]
    if version is None or EXTENSION_NAME not in extensions:
        drafts += [name for name in DRAFT_ATTRIBUTES if name in attributes]
    return SplatPrimitive(
        location=f"{location}, {where}",
        counts=counts,
        sh_degree=degree,
        spz_version=version,
        drafts=tuple(drafts),
        conforms=tuple(_disagreements(primitive, extensions)),
    )


def _disagreements(primitive: JsonDict, extensions: JsonDict) -> Iterator[str]:
    if primitive.get("mode", 4) != 0:
        yield f"mode {primitive.get('mode', 4)!r:.40} instead of 0, points"
    extension = extensions.get(EXTENSION_NAME)
    if isinstance(extension, dict) and extension.get("kernel", "ellipse") != "ellipse":
        yield f"kernel {extension['kernel']!r:.40} instead of ellipse"


def _spz_head(container: Container, extension_parent: JsonDict, where: str) -> tuple[int, int, int]:
    """Return version, splat count and SH degree from the header of SPZ data in a buffer view."""
    view = container.item("bufferViews", extension_parent.get("bufferView"), where)
    start, size = view_range(container, view, where)
    head = bytes(container.data[start : start + min(size, _SPZ_HEAD_BYTES)])
    if head[:2] == b"\x1f\x8b":
        try:
            head = zlib.decompressobj(wbits=31).decompress(head, _SPZ_HEADER.size)
        except zlib.error as error:
            raise TilesetInvalid(
                f"the SPZ data cannot be unpacked ({error})",
                location=where,
                expected="gzip",
                fault=Fault.CONTENT,
            ) from error
    if len(head) < _SPZ_HEADER.size or head[:4] != b"NGSP":
        raise TilesetInvalid(
            f"the SPZ data begin with {head[:4].hex(' ')}",
            location=where,
            expected="4e 47 53 50 (NGSP), as SPZ begins",
            fault=Fault.CONTENT,
        )
    _, version, count, degree, _ = _SPZ_HEADER.unpack_from(head)
    return version, count, degree


def decode_content(
    container: Container, location: str, *, max_bytes: int = MAX_DECODED_BYTES
) -> list[tuple[Splats, Float64[np.ndarray, "4 4"]]]:
    """Decode the splats of a tile's content.

    Returns:
        For each set of splats, as it is stored, the matrix that puts it in the content's
        frame, which is y up.
    """
    header = read_header(container, location, 0)
    if header.splats * _DECODED_SPLAT_BYTES > max_bytes:
        raise TilesetInvalid(
            f"the content has {header.splats:,} splats",
            location=location,
            expected=f"{max_bytes // _DECODED_SPLAT_BYTES:,} or fewer in a tile",
            fault=Fault.CONTENT,
        )
    drafts = sorted({name for entry in header.primitives for name in entry.drafts})
    if drafts:
        text = f"{location}: names of a draft are read ({', '.join(drafts)})"
        warnings.warn(text, FormatWarning, stacklevel=2)
    with raise_as_fault(location, Fault.VALUES), np.errstate(all="ignore"):
        return [
            (read_primitive(container, primitive, where, max_bytes), matrix)
            for primitive, matrix, where in scene_primitives(container)
            if is_splats(primitive)
        ]

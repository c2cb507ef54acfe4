"""Generates small tilesets that fixtures and tests change and write."""

__all__ = ["edit_glb", "explicit_sketch", "implicit_sketch", "sample_splats"]

import json
import math
import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsgen.conformance.fixtures.builders.folder_sketch import FolderSketch
from gsgen.contract.process.drafts import temporary_folder
from gsgen.formats.glb.container import build
from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.splats import Splats
from gsgen.tiles.format.extensions import CodecName
from gsgen.tiles.format.implicit_tiling.writing import implicit_uri, write_implicit_tileset
from gsgen.tiles.format.index import (
    BUILD_RECORD,
    ContentRecord,
    TileRecord,
    content_uri,
    tileset_document,
    write_build_record,
)
from gsgen.tiles.format.json_values import JsonDict
from gsgen.tiles.gltf.encoding import write_content

_ROW_COUNT = 24
_TILE_CENTERS = ((0.0, 0.0, 0.0), (10.0, 0.0, 0.0))
_GEOMETRIC_ERROR = 1.0
_JsonEdit = Callable[[JsonDict], JsonDict]


def sample_splats(
    rows: int, center: tuple[float, float, float], *, degree: int = 1, seed: int = 0
) -> Splats:
    """Return random splats within 1.6 units of a point, each thinner than 0.1 units."""
    rng = np.random.default_rng(seed)
    offset = rng.uniform(-1.6, 1.6, (rows, 3))
    return Splats(
        position=(offset + center).astype(np.float32),
        rotation=rng.normal(size=(rows, 4)).astype(np.float32),
        log_scale=rng.uniform(-5.0, -2.5, (rows, 3)).astype(np.float32),
        logit_opacity=rng.normal(1.0, 1.0, rows).astype(np.float32),
        sh=rng.normal(0, 0.2, (rows, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def explicit_sketch(
    *,
    codec: CodecName = "spz",
    transform: Float64[np.ndarray, "4 4"] | None = None,
    record: bool = True,
    leaf_rows: int = _ROW_COUNT,
    edit_root: Callable[[Splats], Splats] | None = None,
    qualities: tuple[int, ...] = (0,),
) -> FolderSketch:
    """Return an explicit tileset of a root and two leaves.

    Args:
        codec: Of the contents.
        transform: Of the root.
        record: Whether there is a build record.
        leaf_rows: Splats of the first leaf; where they are many, all are alike.
        edit_root: Changes the splats of the root's content, a third of those of the leaves.
        qualities: Of SPZ, finest first.
    """
    leaves = [sample_splats(_ROW_COUNT, center, seed=n) for n, center in enumerate(_TILE_CENTERS)]
    coarse_splats = join_splats([_rows(leaf, slice(None, None, 3)) for leaf in leaves])
    if edit_root is not None:
        coarse_splats = edit_root(coarse_splats)
    if leaf_rows > _ROW_COUNT:
        leaves[0] = _rows(leaves[0], np.zeros(leaf_rows, int))
    files: dict[str, bytes] = {}
    children = tuple(
        _leaf_record(leaf, n, codec, files, qualities) for n, leaf in enumerate(leaves)
    )
    root = _tile_record(
        coarse_splats, 0, (0, 0, 0), codec, files, qualities, error=_GEOMETRIC_ERROR
    )
    root = replace(root, cell=_GEOMETRIC_ERROR / 4, children=children)
    document = tileset_document(
        root, source_splats=sum(map(len, leaves)), sh_degree=1, codec=codec, transform=transform
    )
    sketch = FolderSketch(document, files)
    if record:
        _add_record(sketch, sum(map(len, leaves)))
    return sketch


def _leaf_record(
    splats: Splats,
    number: int,
    codec: CodecName,
    files: dict[str, bytes],
    qualities: tuple[int, ...],
) -> TileRecord:
    leaf = _tile_record(splats, 1, (number, 0, 0), codec, files, qualities)
    center = np.array(_TILE_CENTERS[number])
    return replace(leaf, low=center - 2.0, high=center + 2.0)


def _tile_record(
    splats: Splats,
    level: int,
    coordinates: tuple[int, int, int],
    codec: CodecName,
    files: dict[str, bytes],
    qualities: tuple[int, ...] = (0,),
    *,
    implicit: bool = False,
    error: float = 0.0,
) -> TileRecord:
    middle = splats.position.astype(np.float64).mean(axis=0)
    contents: list[ContentRecord] = []
    for quality in qualities:
        encoded = write_content(splats, middle, codec=codec, quality=quality)
        uri = content_uri(level, coordinates, encoded.data)
        if implicit:
            uri = implicit_uri(level, coordinates, len(contents))
        files[uri] = encoded.data
        content = ContentRecord(
            uri=uri,
            size=len(encoded.data),
            low=encoded.low,
            high=encoded.high,
            worth=encoded.worth,
            error=error + math.sqrt(encoded.squared_shift),
        )
        contents.append(content)
    return TileRecord(
        level=level,
        coordinates=coordinates,
        low=np.min([content.low for content in contents], axis=0),
        high=np.max([content.high for content in contents], axis=0),
        geometric_error=error,
        splats=encoded.splats,
        contents=tuple(contents),
    )


def _rows(splats: Splats, rows: slice | np.ndarray) -> Splats:
    names = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    return replace(splats, **{name: getattr(splats, name)[rows] for name in names})


def implicit_sketch(*, codec: CodecName = "spz", qualities: tuple[int, ...] = (0,)) -> FolderSketch:
    """Return an implicit octree of three levels over a cube of 16, in subtrees of two levels."""
    cells = [(0, 0, 0), (3, 0, 1), (3, 1, 1), (2, 3, 2)]
    files: dict[str, bytes] = {}
    leaves: dict[tuple[int, int, int], Splats] = {}
    for number, cell in enumerate(cells):
        x, y, z = (-8 + 4 * value + 2.0 for value in cell)
        leaves[cell] = sample_splats(_ROW_COUNT, (x, y, z), seed=number)
    records = {
        (2, cell): _tile_record(splats, 2, cell, codec, files, qualities, implicit=True)
        for cell, splats in leaves.items()
    }
    for level in (1, 0):
        for x, y, z in sorted({_parent_coordinates(cell, 2 - level) for cell in cells}):
            inner = [cell for cell in cells if _parent_coordinates(cell, 2 - level) == (x, y, z)]
            coarse_splats = join_splats([_rows(leaves[cell], slice(0, 8)) for cell in inner])
            below = [
                entry
                for (depth, cell), entry in records.items()
                if depth == level + 1 and _parent_coordinates(cell, 1) == (x, y, z)
            ]
            entry = _tile_record(
                coarse_splats,
                level,
                (x, y, z),
                codec,
                files,
                qualities,
                implicit=True,
                error=0.5 * (2 - level),
            )
            records[level, (x, y, z)] = replace(entry, children=tuple(below))
    total = sum(map(len, leaves.values()))
    with temporary_folder() as folder:
        path = folder / "tileset.json"
        uris = write_implicit_tileset(
            path,
            records[0, (0, 0, 0)],
            source_splats=total,
            sh_degree=1,
            codec=codec,
            subtree_levels=2,
        )
        files |= {uri: (path.parent / uri).read_bytes() for uri in uris}
        sketch = FolderSketch(json.loads(path.read_bytes()), files)
    _add_record(sketch, total)
    return sketch


def _parent_coordinates(cell: tuple[int, int, int], levels: int) -> tuple[int, int, int]:
    x, y, z = (value >> levels for value in cell)
    return x, y, z


def _add_record(sketch: FolderSketch, source_splats: int) -> None:
    with temporary_folder() as folder:
        path = folder / BUILD_RECORD
        write_build_record(path, key="example", source_splats=source_splats, files=sketch.files)
        sketch.files[BUILD_RECORD] = path.read_bytes()


def edit_glb(
    data: bytes,
    *,
    document: _JsonEdit | None = None,
    binary: Callable[[bytes], bytes] | None = None,
) -> bytes:
    """Return a GLB file with an edited JSON document or binary chunk."""
    json_size = struct.unpack_from("<I", data, 12)[0]
    values: JsonDict = json.loads(data[20 : 20 + json_size])
    chunk = data[28 + json_size :]
    if binary is not None:
        chunk = binary(chunk)
        values["buffers"][0]["byteLength"] = len(chunk)
        if len(values["bufferViews"]) == 1:
            values["bufferViews"][0]["byteLength"] = len(chunk)
        chunk += bytes(-len(chunk) % 4)
    if document is not None:
        values = document(values)
    return build(values, len(chunk)) + chunk

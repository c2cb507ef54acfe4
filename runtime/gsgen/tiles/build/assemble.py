"""Writes the ``tileset.json`` of a built tileset, and deletes files of earlier builds."""

__all__ = ["is_complete", "remove_stale", "walk", "write_index", "write_record"]

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from gsgen.contract.file_kinds.names import META_FILE, STREAMED_META
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.formats.merging.levels import geometric_error
from gsgen.formats.tileset_paths import INDEX_FILE
from gsgen.tiles.build.files import read_json
from gsgen.tiles.build.neural_tiles import Generator, add_neural_tiles
from gsgen.tiles.build.plan import Plan, coordinates_of, depth_of
from gsgen.tiles.build.tile import Tile
from gsgen.tiles.format.implicit_tiling.writing import write_implicit_tileset
from gsgen.tiles.format.index import (
    BUILD_RECORD,
    TileRecord,
    tileset_document,
    write_build_record,
    write_document,
)
from gsgen.tiles.format.json_values import JsonDict

_WRITTEN_FILES: Final = (
    *("t/*/*.glb", "s/*/*.subtree", "tileset*.json", "n/*"),
    *(STREAMED_META, f"[0-9]_*/{META_FILE}", "[0-9]_*/*.webp"),
)


def write_index(
    plan: Plan, root: Tile, key: str, generators: Sequence[Generator] = ()
) -> dict[str, tuple[int, str]]:
    """Write a ``tileset.json`` for each SPZ quality, then the record of the tileset build.

    Generators become neural tiles beside the tree of the scenes.

    Returns:
        Every file of the tileset: path → bytes and sha256.
    """
    output = Path(plan.output)
    record, neural_files = _tile_record(root), dict[str, tuple[int, str]]()
    if generators:
        record, neural_files = add_neural_tiles(
            record,
            generators,
            output,
            codec=plan.parameters.codec,
            color_space=plan.color_space,
            antialiased=plan.antialiased,
        )
    neural_tiles = [tile for tile in record.children if tile.neural is not None]
    count = plan.count + sum(tile.splats for tile in neural_tiles)
    degrees = [min(generator.first_frame.degree, MAX_DEGREE) for generator in generators]
    transform = np.array(plan.parameters.transform).reshape(4, 4).T
    names = {INDEX_FILE: 0}
    qualities = plan.parameters.qualities
    if len(qualities) > 1:
        names |= {f"tileset-q{quality}.json": i for i, quality in enumerate(qualities)}
    facts: JsonDict = {
        "source_splats": count,
        "sh_degree": max([*(tile.sh_degree for tile in walk(root)), *degrees]),
        "codec": plan.parameters.codec,
        "transform": transform,
        "origin": plan.parameters.origin,
    }
    subtrees: list[str] = []  # the indices of all qualities share them
    for name, quality in names.items():
        if plan.parameters.implicit:
            low = np.array(plan.cube.low)
            octree = replace(record, low=low, high=low + plan.cube.side)
            subtrees = write_implicit_tileset(output / name, octree, quality=quality, **facts)
        else:
            document = tileset_document(record, quality=quality, **facts)
            write_document(output / name, document)
    files = {
        content.uri: (content.size, content.sha256)
        for tile in walk(root)
        for content in tile.contents
    } | neural_files
    for name in [*names, *subtrees]:
        data = (output / name).read_bytes()
        files[name] = len(data), hashlib.sha256(data).hexdigest()
    write_record(plan, key, count, files)
    return files


def write_record(plan: Plan, key: str, count: int, files: Mapping[str, tuple[int, str]]) -> None:
    """Write the record of a build, which is complete with it."""
    path = Path(plan.output) / BUILD_RECORD
    write_build_record(path, key=key, source_splats=count, files=dict(files))


def walk(tile: Tile) -> Iterator[Tile]:
    """Yield a tile and all its descendants, depth first."""
    yield tile
    for child in tile.children:
        yield from walk(child)


def _tile_record(tile: Tile) -> TileRecord:
    return TileRecord(
        level=depth_of(tile.location),
        coordinates=coordinates_of(tile.location),
        # One box for all qualities, so that their trees are the same.
        low=np.min([content.low for content in tile.contents], axis=0),
        high=np.max([content.high for content in tile.contents], axis=0),
        geometric_error=geometric_error(tile.squared_shift),
        cell=tile.cell,
        splats=tile.splats,
        contents=tile.contents,
        children=tuple(_tile_record(child) for child in tile.children),
        oversized=tile.extra > 0,
    )


def is_complete(output: Path, key: str) -> JsonDict | None:
    """Return the record of a finished tileset build with equal inputs and options, or None.

    Every file has to be there with the size that the record has for it.
    """
    path = output / BUILD_RECORD
    if not path.is_file():
        return None
    record: JsonDict = read_json(path)
    if record.get("key") != key:
        return None
    sizes = ((output / name, entry["bytes"]) for name, entry in record["files"].items())
    whole = all(file.is_file() and file.stat().st_size == size for file, size in sizes)
    return record if whole else None


def remove_stale(output: Path, files: dict[str, tuple[int, str]]) -> int:
    """Delete files of earlier builds that the tileset no longer names; return their number."""
    stale_files = [
        path
        for pattern in _WRITTEN_FILES
        for path in output.glob(pattern)
        if path.relative_to(output).as_posix() not in files
    ]
    for path in stale_files:
        path.unlink(missing_ok=True)
    for folder in [*output.glob("[ts]/*"), *output.glob("[nts]"), *output.glob("[0-9]_*")]:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
    return len(stale_files)

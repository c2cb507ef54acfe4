"""Writes the tiles of a part of the octree, leaves first, and the tiles above all parts."""

__all__ = ["build_partition", "build_top_levels", "load_built", "load_units"]

from pathlib import Path

import numpy as np
from jaxtyping import Int64, UInt64

from gsgen.formats.merging.levels import merge_level
from gsgen.formats.merging.mixture import Mixture, concatenate
from gsgen.formats.merging.morton import DEPTH, cell_codes, morton_codes
from gsgen.tiles.build.files import read_json, save_array, write_json
from gsgen.tiles.build.plan import Partition, Plan, depth_of, group_small_octants
from gsgen.tiles.build.spill import Rows, anchors_of, load_partition
from gsgen.tiles.build.streamed_sog import write_units
from gsgen.tiles.build.tile import Tile, tile_from_json, write_leaf, write_level
from gsgen.tiles.format.json_values import JsonDict

BuiltTiles = tuple[list[Tile], Mixture]
"""Tiles that stand side by side, and what they show."""


def build_partition(plan: Plan, partition: Partition) -> int:
    """Write the missing tiles of a part of the octree; return the part's number of splats."""
    name = f"partition-{partition.index:06}"
    if _marker_file(plan, name).exists():
        return partition.count
    rows = load_partition(plan, partition)
    codes = morton_codes(rows["position"], plan.cube)
    order = np.argsort(codes, kind="stable")  # rows are in the order of the scenes already
    rows, codes = rows[order], codes[order]
    location = partition.locations[0]
    if plan.parameters.is_streamed_sog:
        units = write_units(plan, rows, codes, depth_of(location))
        write_json(_marker_file(plan, name), units)
        return partition.count
    if partition.is_anchored:
        built_tiles = _write_large_splats(plan, rows, codes, location)
    elif len(partition.locations) > 1:
        built_tiles = _write_leaf_tile(plan, rows, codes, location)
    else:
        built_tiles = _build_cell(plan, rows, codes, anchors_of(plan, rows), location)
    _save_tiles(plan, name, *built_tiles)
    return partition.count


def _write_leaf_tile(
    plan: Plan, rows: Rows, codes: UInt64[np.ndarray, " n"], location: int
) -> BuiltTiles:
    tile, mixture = write_leaf(plan, rows, codes, location)
    return [tile], mixture


def _build_cell(
    plan: Plan,
    rows: Rows,
    codes: UInt64[np.ndarray, " n"],
    anchors: Int64[np.ndarray, " n"],
    location: int,
) -> BuiltTiles:
    """Write the tile of an octree cell and all its descendants, depth first."""
    depth, leaf = depth_of(location), plan.parameters.leaf
    implicit = plan.parameters.implicit
    if len(rows) <= leaf or (depth == DEPTH and implicit):
        return _write_leaf_tile(plan, rows, codes, location)
    parts: list[BuiltTiles] = []
    # 1. Large splats stay at this cell, in extra leaves beside the children.
    large_rows = anchors == depth
    extra = (
        _write_large_splats(plan, rows[large_rows], codes[large_rows], location)
        if large_rows.any()
        else None
    )
    if extra is not None:
        rows, codes, anchors = rows[~large_rows], codes[~large_rows], anchors[~large_rows]
    # 2. The others go to the octants; small neighbours become one leaf.
    octant_codes = cell_codes(codes, min(depth + 1, DEPTH))
    names, counts = np.unique(octant_codes, return_counts=True)
    limits = np.concatenate([[0], np.cumsum(counts)])
    for group in group_small_octants(counts.tolist(), 0 if implicit else leaf):
        group_rows = slice(limits[group[0]], limits[group[-1] + 1])
        child = 1 << 3 * (depth + 1) | int(names[group[0]])
        if len(group) > 1:
            parts.append(_write_leaf_tile(plan, rows[group_rows], codes[group_rows], child))
        else:
            parts.append(
                _build_cell(plan, rows[group_rows], codes[group_rows], anchors[group_rows], child)
            )
    if extra is not None:
        parts.append(extra)
    return _write_parent_tile(plan, location, parts)


def _write_large_splats(
    plan: Plan, rows: Rows, codes: UInt64[np.ndarray, " n"], location: int
) -> BuiltTiles:
    """Write the splats too large for an octree cell's children, as leaf tiles at the cell."""
    count = -(-len(rows) // plan.parameters.leaf)
    limits = [len(rows) * index // count for index in range(count + 1)]
    parts = (slice(*limits[index : index + 2]) for index in range(count))
    leaves = [
        write_leaf(plan, rows[part], codes[part], location, number)
        for number, part in enumerate(parts, 1)
    ]
    return [tile for tile, _ in leaves], concatenate([mixture for _, mixture in leaves])


def _write_parent_tile(plan: Plan, location: int, parts: list[BuiltTiles]) -> BuiltTiles:
    """Write the parent tile of several tiles; a single tile needs no parent."""
    tiles = [tile for part, _ in parts for tile in part]
    mixture = concatenate([part for _, part in parts])
    if len(tiles) == 1 and not plan.parameters.implicit:
        return tiles, mixture
    depth = depth_of(location)
    level = merge_level(mixture, depth, plan.parameters.leaf)
    return [write_level(plan, level, location, tiles)], level.mixture


def build_top_levels(plan: Plan, location: int) -> int:
    """Write the tile of an octree cell above all partitions if it does not exist yet.

    The cells below it have to be built. Returns 0: no splat of the scenes is new here.
    """
    name = f"top-{location}"
    if _marker_file(plan, name).exists():
        return 0
    below = [name for name, parent_cell in _parent_cells(plan).items() if parent_cell == location]
    _save_tiles(
        plan,
        name,
        *_write_parent_tile(plan, location, [_load_built_tiles(plan, name) for name in below]),
    )
    return 0


def _parent_cells(plan: Plan) -> dict[str, int]:
    """Map each octree partition and each cell above the partitions to its parent, depth first."""
    entries: list[tuple[int, int, bool, str]] = []
    for partition in plan.partitions:
        name = f"partition-{partition.index:06}"
        key = partition.parent_cell, partition.locations[0], partition.is_anchored, name
        entries.append(key)
    entries += [(cell >> 3, cell, False, f"top-{cell}") for cell in plan.top]
    # Octants in order, then the leaves of large splats.
    entries.sort(key=lambda entry: (entry[0], entry[2], entry[1]))
    return {name: parent_cell for parent_cell, _, _, name in entries}


def load_built(plan: Plan) -> list[Tile]:
    """Return the tiles at the octree's root; call this when all partitions are built."""
    name = f"top-{plan.top[-1]}" if plan.top else "partition-000000"
    return _load_tiles(plan, name)


def load_units(plan: Plan) -> list[JsonDict]:
    """Return the units of a streamed SOG; call this when all partitions are built."""
    names = [f"partition-{partition.index:06}" for partition in plan.partitions]
    return [unit for name in names for unit in read_json(_marker_file(plan, name))]


def _marker_file(plan: Plan, name: str) -> Path:
    return Path(plan.work) / "tiles" / f"{name}.json"


def _save_tiles(plan: Plan, name: str, tiles: list[Tile], mixture: Mixture) -> None:
    folder = Path(plan.work) / "tiles"
    save_array(folder / f"{name}.npy", _pack_mixture(mixture))
    write_json(_marker_file(plan, name), [tile.as_json() for tile in tiles])


def _load_built_tiles(plan: Plan, name: str) -> BuiltTiles:
    packed = np.load(Path(plan.work) / "tiles" / f"{name}.npy")
    return _load_tiles(plan, name), _unpack_mixture(packed)


def _load_tiles(plan: Plan, name: str) -> list[Tile]:
    return [tile_from_json(value) for value in read_json(_marker_file(plan, name))]


def _pack_mixture(mixture: Mixture) -> np.ndarray:
    fields = [
        (name, value.dtype, value.shape[1:])
        for name in Mixture.__slots__
        for value in [getattr(mixture, name)]
    ]
    rows = np.empty(len(mixture), np.dtype(fields))
    for name in Mixture.__slots__:
        rows[name] = getattr(mixture, name)
    return rows


def _unpack_mixture(rows: np.ndarray) -> Mixture:
    names = Mixture.__slots__
    return Mixture(**{name: np.ascontiguousarray(rows[name]) for name in names})

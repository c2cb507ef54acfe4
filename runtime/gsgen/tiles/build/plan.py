"""The plan of a tileset build: octree partitions, one for each task, and the cells above.

A cell with at most ``partition`` splats is a partition: one task sorts its splats and builds all
tiles in it. The cells above are *top* cells. Splats that are anchored at a top cell form a
partition of their own, a few large splats that become extra leaves.
"""

__all__ = [
    "Partition",
    "Plan",
    "coordinates_of",
    "depth_of",
    "group_small_octants",
    "load_plan",
    "make_partitions",
    "octree_runs",
    "partition_of",
    "save_plan",
]

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Int64, UInt64

from gsgen.formats.merging.morton import DEPTH, Cube, cell_codes
from gsgen.formats.ply.chunks import PlyTable
from gsgen.tiles.build.files import read_json, write_json
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.scan import location_codes
from gsgen.tiles.build.source import Chunk, SceneFile


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Partition:
    """A part of the octree whose tiles one task writes.

    Attributes:
        index: Of the partition.
        locations: Its cells, each as 1 followed by its Morton code: one, or neighbours in one
            cell above that are so small that together they are a leaf.
        is_anchored: Whether it holds only the splats that are anchored at the cell itself.
        count: Splats.
    """

    index: int
    locations: tuple[int, ...]
    is_anchored: bool
    count: int

    @property
    def parent_cell(self) -> int:
        """The parent octree cell of the partition; 0 if the partition holds the whole scene."""
        return self.locations[0] if self.is_anchored else self.locations[0] >> 3


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """The plan of a tileset build: scene chunks, octree partitions, cells above, and parameters.

    Attributes:
        cube: The root cube.
        degree: SH degree of the rows.
        antialiased: See :class:`gsgen.formats.Splats`.
        color_space: See :class:`gsgen.formats.Splats`.
        count: Splats of all partitions.
        partitions: All of them; none overlaps another.
        top: Locations of the cells above the partitions, deepest first.
        parameters: Of the build.
        chunks: Of the scenes.
        output: Folder of the tileset.
        work: Folder for spills and markers.
    """

    cube: Cube
    degree: int
    antialiased: bool
    color_space: str
    count: int
    partitions: tuple[Partition, ...]
    top: tuple[int, ...]
    parameters: BuildParameters
    chunks: tuple[Chunk, ...]
    output: str
    work: str


def depth_of(location: int) -> int:
    """Return the depth of an octree cell that is given as 1 followed by its Morton code."""
    return (location.bit_length() - 1) // 3


def coordinates_of(location: int) -> tuple[int, int, int]:
    """Return the x, y and z index of an octree cell in the grid of all cells of its depth."""
    depth = depth_of(location)
    x, y, z = (
        sum((location >> (3 * bit_index + axis) & 1) << bit_index for bit_index in range(depth))
        for axis in range(3)
    )
    return x, y, z


def make_partitions(
    cells: UInt64[np.ndarray, " c"], counts: Int64[np.ndarray, " c"], limit: int, leaf: int
) -> tuple[tuple[Partition, ...], tuple[int, ...]]:
    """Divide an octree into partitions of at most ``limit`` splats.

    Args:
        cells: Location codes of cells, each once, without the splats of deeper ones.
        counts: Splats of each cell.
        limit: Most splats of a partition; a cell that is not divided further may have more.
        leaf: Neighbours that have no more together are one partition; 0 keeps all apart.

    Returns:
        The partitions, in depth-first order, and the top cells, deepest first.
    """
    cell_counts = dict(zip(cells.tolist(), counts.tolist(), strict=True))
    total, children = _subtree_totals(cell_counts)
    partitions: list[Partition] = []
    top: list[int] = []

    def add(locations: tuple[int, ...], count: int, *, is_anchored: bool) -> None:
        index = len(partitions)
        partitions.append(
            Partition(index=index, locations=locations, is_anchored=is_anchored, count=count)
        )

    pending: list[tuple[int, ...]] = [(1,)]
    while pending:
        group = pending.pop()
        cell = group[0]
        # Case 1: the cells fit one partition, or cannot be divided.
        if len(group) > 1 or total[cell] <= limit or cell not in children:
            add(group, sum(total[member] for member in group), is_anchored=False)
            continue
        # Case 2: divide the cell; splats that are too large for its children are a partition.
        top.append(cell)
        below = sorted(children[cell])
        runs = group_small_octants([total[child] for child in below], leaf)
        pending += [tuple(below[index] for index in run) for run in reversed(runs)]
        if cell_counts.get(cell, 0):
            add((cell,), cell_counts[cell], is_anchored=True)
    top.sort(key=lambda cell: (-depth_of(cell), cell))
    return tuple(partitions), tuple(top)


def _subtree_totals(cell_counts: dict[int, int]) -> tuple[dict[int, int], dict[int, list[int]]]:
    """Return the splat count of each octree cell with its descendants, and each cell's children."""
    depths: dict[int, list[int]] = {}
    for cell in cell_counts:
        depths.setdefault(depth_of(cell), []).append(cell)
    total: dict[int, int] = {}
    children: dict[int, list[int]] = {}
    below: dict[int, int] = {}
    for depth in range(max(depths), -1, -1):
        level = {cell: cell_counts[cell] for cell in depths.get(depth, ())}
        for cell, count in below.items():
            level[cell >> 3] = level.get(cell >> 3, 0) + count
            children.setdefault(cell >> 3, []).append(cell)
        total |= level
        below = level
    return total, children


def group_small_octants(counts: Sequence[int], limit: int) -> list[list[int]]:
    """Group neighbouring octants of an octree cell while a group has ``limit`` splats at most.

    Octants that a surface only touches would be leaves of a few splats, each a request.
    """
    groups: list[list[int]] = []
    size = 0
    for index, count in enumerate(counts):
        if groups and size + count <= limit:
            groups[-1].append(index)
            size += count
        else:
            groups.append([index])
            size = count
    return groups


def octree_runs(codes: UInt64[np.ndarray, " n"], depth: int, most: int) -> Iterator[slice]:
    """Yield the rows of octree cells of at most ``most`` splats; small neighbours are one run.

    Args:
        codes: Sorted Morton codes of the splats of one cell.
        depth: Of the cell.
        most: A cell that cannot be divided may have more.
    """
    if len(codes) <= most or depth == DEPTH:
        yield slice(0, len(codes))
        return
    _, counts = np.unique(cell_codes(codes, depth + 1), return_counts=True)
    limits = np.concatenate([[0], np.cumsum(counts)])
    for group in group_small_octants(counts.tolist(), most):
        first, last = int(limits[group[0]]), int(limits[group[-1] + 1])
        if len(group) > 1:
            yield slice(first, last)
            continue
        for run in octree_runs(codes[first:last], depth + 1, most):
            yield slice(first + run.start, first + run.stop)


def partition_of(
    codes: UInt64[np.ndarray, " n"],
    anchors: Int64[np.ndarray, " n"],
    partitions: Iterable[Partition],
) -> Int64[np.ndarray, " n"]:
    """Return the number of the octree partition that contains each splat."""
    result = np.full(len(codes), -1, np.int64)
    groups: dict[tuple[int, bool], list[tuple[int, int]]] = {}
    for partition in partitions:
        for location in partition.locations:
            key = depth_of(location), partition.is_anchored
            groups.setdefault(key, []).append((location, partition.index))
    # One binary search a depth; a partition of large splats takes those anchored at its depth.
    for (depth, is_anchored), members in groups.items():
        members.sort()
        known = np.array([location for location, _ in members], np.uint64)
        index = np.array([number for _, number in members], np.int64)
        cells = location_codes(codes, np.full(len(codes), depth), depth)
        slot = np.minimum(np.searchsorted(known, cells), len(known) - 1)
        is_known_cell = known[slot] == cells
        is_known_cell &= anchors == depth if is_anchored else anchors >= depth
        result[is_known_cell] = index[slot[is_known_cell]]
    return result


def save_plan(plan: Plan, path: Path) -> None:
    """Write the plan of a tileset build to a file."""
    content = asdict(plan)
    content["files"] = [asdict(file) for file in _files(plan)]
    for chunk in content["chunks"]:
        chunk["file"] = next(
            index
            for index, file in enumerate(content["files"])
            if file["path"] == chunk["file"]["path"]
        )
    write_json(path, content)


def _files(plan: Plan) -> list[SceneFile]:
    return list({chunk.file.path: chunk.file for chunk in plan.chunks}.values())


@lru_cache(maxsize=2)
def load_plan(path: str) -> Plan:
    """Return the plan of a tileset build from a file, which each process reads once."""
    content = read_json(Path(path))
    files = [_file(item) for item in content.pop("files")]
    chunks = tuple(Chunk(**{**item, "file": files[item["file"]]}) for item in content["chunks"])
    parameters = content["parameters"]
    parameters["qualities"] = tuple(parameters["qualities"])
    parameters["transform"] = tuple(parameters["transform"])
    parameters["origin"] = parameters["origin"] and tuple(parameters["origin"])
    content |= {
        "chunks": chunks,
        "cube": Cube(tuple(content["cube"]["low"]), content["cube"]["side"]),
        "parameters": BuildParameters(**parameters),
        "partitions": tuple(
            Partition(**{**item, "locations": tuple(item["locations"])})
            for item in content["partitions"]
        ),
        "top": tuple(content["top"]),
    }
    return Plan(**content)


def _file(item: Mapping[str, Any]) -> SceneFile:
    table = item["table"]
    if table is not None:
        table = PlyTable(**{**table, "columns": tuple(table["columns"])})
    return SceneFile(**{**item, "table": table, "origin": tuple(item["origin"])})

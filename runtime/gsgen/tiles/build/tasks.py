"""The tasks of a tileset build, as functions that any engine can run in any process.

A task is a plain value; it writes its result to a file that appears whole, and does nothing if
that is there already. So it can be run twice, elsewhere, or again after a crash.
"""

__all__ = [
    "CountTask",
    "PlanTask",
    "run_bin",
    "run_count",
    "run_parent_cell",
    "run_partition",
    "run_scan",
]

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Int64, UInt64

from gsgen.formats.merging.morton import Cube
from gsgen.tiles.build.files import read_json, save_array, write_json
from gsgen.tiles.build.octree import build_partition, build_top_levels
from gsgen.tiles.build.plan import load_plan
from gsgen.tiles.build.scan import ChunkFacts, count_cells, scan_chunk
from gsgen.tiles.build.source import Chunk
from gsgen.tiles.build.spill import bin_chunk


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ScanTask:
    """A build task that scans a chunk of a scene file."""

    chunk: Chunk
    work: str


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CountTask:
    """A build task that counts the splats of a scene chunk in octree cells.

    Attributes:
        chunk: To be read.
        cube: The root cube.
        depth: Of the cells.
        parent_cells: Sorted codes of the cells to count in; None for all.
        parent_depth: Depth of ``parent_cells``.
        is_anchored: Whether large splats stay at the depth of their anchor.
        work: Folder of markers.
    """

    chunk: Chunk
    cube: Cube
    depth: int
    parent_cells: UInt64[np.ndarray, " c"] | None
    parent_depth: int
    is_anchored: bool
    work: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanTask:
    """A task of a tileset build: one scene chunk, octree partition, or cell above the partitions.

    Attributes:
        plan: Path of ``plan.json``.
        item: Index of the chunk or partition, or location of the top cell.
    """

    plan: str
    item: int


def run_scan(task: ScanTask) -> tuple[int, ChunkFacts]:
    """Scan a scene chunk; return its size in rows, bounding box, splat counts and digests."""
    marker_path = Path(task.work) / "scan" / f"{task.chunk.index:06}.json"
    if marker_path.exists():
        content = read_json(marker_path)
        content |= {name: tuple(content[name]) for name in ("low", "high", "digests")}
        facts = ChunkFacts(**content)
    else:
        facts = scan_chunk(task.chunk)
        write_json(marker_path, asdict(facts))
    return task.chunk.count, facts


def run_count(
    task: CountTask,
) -> tuple[int, tuple[UInt64[np.ndarray, " m"], Int64[np.ndarray, " m"]]]:
    """Count a scene chunk's splats per octree cell; return total, cells and their counts."""
    folder = Path(task.work) / "cells"
    marker_path = folder / f"{task.chunk.index:06}-{task.depth}.npy"
    if marker_path.exists():
        table = np.load(marker_path)
    else:
        cells, counts = count_cells(
            task.chunk,
            task.cube,
            task.depth,
            task.parent_cells,
            task.parent_depth,
            is_anchored=task.is_anchored,
        )
        table = np.stack([cells, counts.astype(np.uint64)])
        save_array(marker_path, table)
    return task.chunk.count, (table[0], table[1].astype(np.int64))


def run_bin(task: PlanTask) -> tuple[int, int]:
    """Write a scene chunk's splats sorted by partition; return the counts read and written."""
    plan = load_plan(task.plan)
    chunk = plan.chunks[task.item]
    return chunk.count, bin_chunk(plan, chunk)


def run_partition(task: PlanTask) -> tuple[int, None]:
    """Write the tiles of an octree partition; return the partition's number of splats."""
    plan = load_plan(task.plan)
    return build_partition(plan, plan.partitions[task.item]), None


def run_parent_cell(task: PlanTask) -> tuple[int, None]:
    """Write the tile of an octree cell above the partitions."""
    return build_top_levels(load_plan(task.plan), task.item), None

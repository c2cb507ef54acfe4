"""Sorts splats on disk: temporary files by octree partition, which tasks read back.

The shuffle is files, so that it is the same on one core, on many and on many machines.
"""

__all__ = ["bin_chunk", "load_partition", "spilled_count"]

from pathlib import Path
from typing import Any

import numpy as np

from gsgen.formats.merging.morton import DEPTH, morton_codes
from gsgen.formats.shared.splat_values import valid_rows
from gsgen.formats.shared.splats import SH_COUNTS
from gsgen.tiles.build.files import save_array
from gsgen.tiles.build.plan import Partition, Plan, partition_of
from gsgen.tiles.build.scan import anchor_depths
from gsgen.tiles.build.source import Chunk, read_chunk, row_dtype

Rows = np.ndarray[Any, np.dtype[Any]]


def bin_chunk(plan: Plan, chunk: Chunk) -> int:
    """Write a scene chunk's splats, sorted by partition, to a temporary file; return their count.

    The file of rows is the marker of the task, so that of the offsets is written before it.
    """
    rows_path, offsets_path = _paths(plan, chunk.index)
    if rows_path.exists():
        return spilled_count(plan, chunk)
    splats = read_chunk(chunk)
    valid_mask = valid_rows(splats)
    rows = np.zeros(int(np.count_nonzero(valid_mask)), row_dtype(plan.degree))
    rows["source"] = np.uint64(chunk.source) + np.flatnonzero(valid_mask).astype(np.uint64)
    for name in ("position", "rotation", "log_scale", "logit_opacity"):
        rows[name] = getattr(splats, name)[valid_mask]
    shared_coefficients = min(splats.sh.shape[1], SH_COUNTS[plan.degree])
    rows["sh"][:, :shared_coefficients] = splats.sh[valid_mask, :shared_coefficients]
    codes = morton_codes(rows["position"], plan.cube)
    partitions = partition_of(codes, anchors_of(plan, rows), plan.partitions)
    order = np.argsort(partitions, kind="stable")
    limits = np.arange(len(plan.partitions) + 1)
    save_array(offsets_path, np.searchsorted(partitions[order], limits).astype(np.int64))
    save_array(rows_path, rows[order])
    return len(rows)


def anchors_of(plan: Plan, rows: Rows) -> np.ndarray:
    """Return each splat's deepest octree level; in implicit octrees, the tree's deepest level."""
    if not plan.parameters.is_anchored:
        return np.full(len(rows), DEPTH, np.int64)
    return anchor_depths(rows["log_scale"], plan.cube)


def spilled_count(plan: Plan, chunk: Chunk) -> int:
    """Return the number of splats of a scene chunk in its temporary file."""
    return int(np.load(_paths(plan, chunk.index)[1])[-1])


def load_partition(plan: Plan, partition: Partition) -> Rows:
    """Read the splats of an octree partition from temporary files, in the scenes' order."""
    rows = np.empty(partition.count, row_dtype(plan.degree))
    row_count = 0
    for chunk in plan.chunks:
        rows_path, offsets_path = _paths(plan, chunk.index)
        first, last = np.load(offsets_path)[partition.index : partition.index + 2]
        if last > first:
            spill_rows = np.load(rows_path, mmap_mode="r")
            rows[row_count : row_count + last - first] = spill_rows[first:last]
            row_count += int(last - first)
    if row_count != partition.count:  # the barrier before this phase makes it impossible
        raise AssertionError(
            f"temporary files hold {row_count} of {partition.count} splats of {partition}"
        )
    return rows


def _paths(plan: Plan, index: int) -> tuple[Path, Path]:
    folder = Path(plan.work) / "bin"
    return folder / f"{index:06}.npy", folder / f"{index:06}.offsets.npy"

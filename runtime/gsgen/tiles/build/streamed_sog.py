"""Writes a streamed SOG: the files of each part of the octree, and then its lod-meta.json.

A *unit* is an octree cell, or small neighbours, with at most ``UNIT_SPLATS`` splats. It has a SOG
file at each level of detail, whose rows are those of its leaves. No unit crosses a partition, so that
no byte depends on how the work is divided. Paths hold digests of the contents, for caches.
"""

__all__ = ["UNIT_SPLATS", "write_streamed_index", "write_units"]

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import UInt64

from gsgen.contract.file_kinds.names import META_FILE, STREAMED_META
from gsgen.formats.sog.streamed_write import Chunks, LeafNode, level_files, streamed_document
from gsgen.formats.sog.write import InMemory, sog_files
from gsgen.tiles.build.files import write_bytes
from gsgen.tiles.build.plan import Plan, octree_runs
from gsgen.tiles.build.spill import Rows
from gsgen.tiles.build.tile import leaf_splats
from gsgen.tiles.format.json_values import JsonDict

UNIT_SPLATS: Final = 1 << 17
"""Most splats of a file: a viewer fetches it whole, and each costs some kilobytes of codebooks."""

_LEVELS: Final = 4


def write_units(
    plan: Plan, rows: Rows, codes: UInt64[np.ndarray, " n"], depth: int
) -> list[JsonDict]:
    """Write the SOG files of a partition of the octree, and describe them.

    Args:
        plan: Of the build.
        rows: The splats of the partition, sorted by ``codes``.
        codes: Their Morton codes.
        depth: Of the partition's cell.

    Returns:
        For each unit its leaves, whose files are numbered from 0, and the names and digests of
        its files, finest first.
    """
    return [
        _write_unit(plan, rows[unit], codes[unit])
        for unit in octree_runs(codes, depth, UNIT_SPLATS)
    ]


def _write_unit(plan: Plan, rows: Rows, codes: UInt64[np.ndarray, " n"]) -> JsonDict:
    runs = octree_runs(codes, 0, plan.parameters.leaf)
    leaves = [LeafNode.of_splats(leaf_splats(plan, rows[run])) for run in runs]
    files: list[list[Any]] = []
    counts: list[int] = []
    for level in range(_LEVELS):
        (splats,) = level_files(leaves, level, level, len(rows))
        contents = sog_files(InMemory(splats), is_sorted=True, has_digests=True)
        digests = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
        folder = f"{level}_{int(codes[0]):x}-{digests[META_FILE][:8]}"
        for name, data in contents.items():
            write_bytes(Path(plan.output) / folder / name, data)
            files.append([f"{folder}/{name}", len(data), digests[name]])
        counts.append(len(splats))
    return {"leaves": [leaf.node for leaf in leaves], "files": files, "counts": counts}


def write_streamed_index(plan: Plan, units: Sequence[JsonDict]) -> dict[str, tuple[int, str]]:
    """Write the lod-meta.json of all units.

    Returns:
        Every file of the streamed SOG: path → bytes and sha256.
    """
    names: list[str] = []
    nodes: list[JsonDict] = []
    files: dict[str, tuple[int, str]] = {}
    for unit in units:
        for leaf in unit["leaves"]:
            for rows in leaf["lods"].values():
                rows["file"] += len(names)
        names += [name for name, _, _ in unit["files"] if name.endswith(META_FILE)]
        files |= {name: (size, digest) for name, size, digest in unit["files"]}
        bounds = [leaf["bound"] for leaf in unit["leaves"]]
        nodes.append({"bound": _union(bounds), "children": unit["leaves"]})
    root = {"bound": _union([node["bound"] for node in nodes]), "children": nodes}
    counts = np.sum([unit["counts"] for unit in units], axis=0).tolist()
    chunks = Chunks(
        levels=_LEVELS,
        file_rows=UNIT_SPLATS,
        leaf_rows=plan.parameters.leaf,
        leaf_size=plan.cube.side,
    )
    data = streamed_document(root, names, counts, chunks)
    write_bytes(Path(plan.output) / STREAMED_META, data)
    return files | {STREAMED_META: (len(data), hashlib.sha256(data).hexdigest())}


def _union(bounds: Sequence[JsonDict]) -> JsonDict:
    low = np.min([bound["min"] for bound in bounds], axis=0)
    return {"min": low.tolist(), "max": np.max([bound["max"] for bound in bounds], axis=0).tolist()}

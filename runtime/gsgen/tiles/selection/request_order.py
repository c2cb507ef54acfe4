"""The order of tile requests: three rules of the viewer, the renderer and the simulator.

1. The root alone: as long as a seen root is missing, nothing else is requested.
2. Then the seen tiles, each at its coarsest file: by level, by falling screen-space error, by index.
3. Finer files of drawn tiles only while no seen tile is missing: by falling worth gained per byte.
"""

__all__ = ["finer_file_order", "missing_tiles", "request_order"]

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.tiles.loading.quality_ladder import QualityLadder
from gsgen.tiles.selection.cut import TileCut
from gsgen.tiles.selection.tile_tree import TileTree


def request_order(tree: TileTree, cut: TileCut) -> Int64[np.ndarray, " m"]:
    """Return all seen tiles by level, then by falling screen-space error, then by index."""
    rows = np.flatnonzero(cut.seen)
    return np.asarray(rows[np.lexsort((rows, -cut.error[rows], tree.level[rows]))])


def missing_tiles(
    order: Int64[np.ndarray, " m"], loaded: Bool[np.ndarray, " n"]
) -> Int64[np.ndarray, " k"]:
    """Return the tiles of a request order that are not loaded; a missing root alone."""
    missing = np.asarray(order[~loaded[order]])
    return missing[:1] if len(missing) and missing[0] == 0 else missing


def finer_file_order(
    tree: TileTree,
    ladder: QualityLadder,
    quality: Int64[np.ndarray, " n"],
    drawn: Bool[np.ndarray, " n"],
    eye: Float64[np.ndarray, " 3"],
) -> Int64[np.ndarray, " m"]:
    """Return the drawn tiles that have a finer file, by worth × area gained per byte of it.

    Args:
        tree: The tiles.
        ladder: Their files; 0 is the finest quality.
        quality: Of the file that each tile is drawn from; −1 for none.
        drawn: The tiles to improve.
        eye: Of the camera, in the root frame.
    """
    rows = np.flatnonzero(drawn & (quality > 0))
    reach = np.linalg.norm(tree.half_axes[rows], axis=(1, 2))
    distance = np.linalg.norm(tree.center[rows] - eye, axis=1)
    area = np.minimum(reach / np.maximum(distance, 1e-9), 1.0) ** 2
    quality_gain = (
        area * (ladder.worth[rows, 0] - ladder.worth[rows, quality[rows]]) / ladder.size[rows, 0]
    )
    return np.asarray(rows[np.lexsort((rows, -quality_gain))])

"""Reduces splats to at most a given number, by merging as for a tileset's coarse levels."""

__all__ = ["decimate", "decimate_measured"]

from dataclasses import replace

import numpy as np
from jaxtyping import Int64

from gsgen.formats.merging.levels import stored_degree
from gsgen.formats.merging.mixture import Mixture
from gsgen.formats.merging.moments import cell_scatter, merge_clusters, squared_shift
from gsgen.formats.merging.morton import DEPTH, Cube, morton_codes, separation_depths
from gsgen.formats.merging.splat_mixtures import mixture_of, splats_of
from gsgen.formats.shared.splats import Splats


def decimate(splats: Splats, count: int) -> Splats:
    """Return at most ``count`` merged splats that look like all the splats, with equal moments.

    Cells of one depth of an octree are as many as may be; of these, the ones whose splats spread
    most, weighted by mass, are split into their eight parts for as long as ``count`` allows.
    """
    return decimate_measured(splats, count)[0]


def decimate_measured(splats: Splats, count: int) -> tuple[Splats, float]:
    """Return the splats of :func:`decimate`, and the :func:`squared_shift` of merging them."""
    if count >= len(splats):
        return splats, 0.0
    low, high = splats.position.min(axis=0), splats.position.max(axis=0)
    cube = Cube.enclosing(low.astype(np.float64), high.astype(np.float64))
    codes = morton_codes(splats.position, cube)
    mixture = mixture_of(splats, codes)
    mixture = mixture.rows(np.argsort(codes, kind="stable"))
    starts = _cluster_starts(mixture, count)
    merged_mixture = merge_clusters(mixture, starts)
    result = splats_of(merged_mixture, stored_degree(merged_mixture))
    names = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    merged = replace(splats, **{name: getattr(result, name) for name in names})
    return merged, squared_shift(mixture, starts)


def _cluster_starts(mixture: Mixture, count: int) -> Int64[np.ndarray, " m"]:
    """Return the first splat of each of at most ``count`` clusters of Morton-sorted splats."""
    # Row i separates from row i − 1 at this depth; the first row separates at once.
    separation = np.concatenate([[0], separation_depths(mixture.code)])
    cell_counts = np.cumsum(np.bincount(separation, minlength=DEPTH + 2))[: DEPTH + 1]
    depth = max(0, int(np.searchsorted(cell_counts, count, side="right")) - 1)
    cluster_start_mask = separation <= depth
    if depth == DEPTH:
        return np.flatnonzero(cluster_start_mask)
    cell = np.cumsum(cluster_start_mask) - 1
    parts = np.bincount(cell[separation == depth + 1], minlength=int(cell[-1]) + 1)
    order = np.argsort(-cell_scatter(mixture, cell), kind="stable")
    order = order[parts[order] > 0]
    is_split = np.zeros(len(parts), bool)
    is_split[
        order[: int(np.searchsorted(np.cumsum(parts[order]), count - len(parts), "right"))]
    ] = 1
    return np.flatnonzero(cluster_start_mask | ((separation == depth + 1) & is_split[cell]))

"""Finds the box of a scene's Gaussians that the default camera shows: all of them but floaters.

A floater is a Gaussian that lies apart from the object, with few others. The space is divided into
cubes, whose side follows from the spread of the middle 80 % of the Gaussians and from their number;
occupied cubes that touch form groups, and groups with less than 2 % of the Gaussians are floaters.
A thin part that sticks out of an object is connected to it, and stays.
"""

__all__ = ["Box", "box_around", "union_of_boxes"]

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsgen.contract.spec import layout
from gsgen.runtime.scene.splat_data import SplatData

Box = tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]
"""The lowest and the highest corner of a box along the axes."""

_SPREAD_QUANTILES: Final = (
    10.0,
    90.0,
)  # percent of the centres between which the object's spread is measured
_MIN_CUBE_SIDE: Final = 1 / 16  # least side of a cube, as a share of the spread
_CUBE_SIDE_SPACINGS: Final = 2.0  # side of a cube in mean distances of evenly spread Gaussians
_MIN_GROUP_SHARE: Final = 0.02  # of all Gaussians, in a group that is part of the object
_LINK_SIGMAS: Final = 2.0  # a Gaussian occupies the cubes within this many standard deviations
_MAX_CUBES_PER_GAUSSIAN: Final = (
    8  # most cubes to each side that one Gaussian occupies along an axis
)
_GRID_SIZE: Final = 1 << 19  # cubes along an axis; Gaussians farther away are floaters
_VISIBLE_ALPHA: Final = 1 / 255
_MAX_GROUPED_GAUSSIANS: Final = 1 << 17  # most Gaussians that are grouped
_NEIGHBOURS: Final = np.array(
    [(x << 42) + (y << 21) + z for x, y, z in itertools.product((-1, 0, 1), repeat=3)]
)
"""Differences between the keys of a cube and of the cubes that touch it, and 0."""


def box_around(data: SplatData) -> Box | None:
    """Return the box that holds all visible Gaussians but floaters, to their visible edges.

    None without Gaussians. Invisible Gaussians count if all are invisible.
    """
    rows = data.rows[: data.count]
    finite = np.isfinite(rows[:, layout.POSITION]).all(axis=1)
    opacity = rows[:, layout.OPACITY]
    is_visible = finite & (opacity > 0)
    chosen_centers = rows[is_visible if is_visible.any() else finite].astype(np.float64)
    if not len(chosen_centers):
        return None
    centers = chosen_centers[:, layout.POSITION]
    variances = chosen_centers[:, layout.VARIANCES]
    sigmas = np.sqrt(np.nan_to_num(np.maximum(variances, 0), nan=0.0, posinf=0.0))
    is_retained = ~_is_floater(centers, sigmas)
    # The edge of a Gaussian is where its alpha falls below what the renderer draws.
    alpha = np.clip(chosen_centers[:, layout.OPACITY], _VISIBLE_ALPHA, 1.0)
    radii = sigmas * np.sqrt(2 * np.log(alpha / _VISIBLE_ALPHA))[:, None]
    low, high = (centers - radii)[is_retained], (centers + radii)[is_retained]
    return low.min(axis=0), high.max(axis=0)


def union_of_boxes(boxes: Sequence[Box | None]) -> Box | None:
    """Return the box around all given boxes; None without any."""
    known = [box for box in boxes if box is not None]
    if not known:
        return None
    lower_corners, upper_corners = zip(*known, strict=True)
    return np.min(lower_corners, axis=0), np.max(upper_corners, axis=0)


def _is_floater(
    centers: Float64[np.ndarray, "n 3"], sigmas: Float64[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Return which Gaussians lie apart from the others, in groups of less than 2 %."""
    no_floaters = np.zeros(len(centers), bool)
    if len(centers) * _MIN_GROUP_SHARE <= 1:
        return no_floaters  # each Gaussian is a group that is large enough
    step = -(-len(centers) // _MAX_GROUPED_GAUSSIANS)
    low, high = np.percentile(centers[::step], _SPREAD_QUANTILES, axis=0)
    scene_spread = float((high - low + 2 * np.median(sigmas[::step], axis=0)).max())
    side = scene_spread * max(
        _MIN_CUBE_SIDE, _CUBE_SIDE_SPACINGS * len(no_floaters[::step]) ** (-1 / 3)
    )
    if not 0 < side < np.inf:
        return no_floaters
    # 1. The cube of each centre; far Gaussians, and those larger than the object, are left out.
    cube_coordinates = np.floor((centers - low) / side)
    has_cube = (np.abs(cube_coordinates) < _GRID_SIZE).all(axis=1) & (sigmas <= scene_spread).all(
        axis=1
    )
    if not has_cube.any():
        return no_floaters
    keys = _keys(cube_coordinates[has_cube])
    # 2. Of a sample, the cubes that each Gaussian reaches.
    reached_keys = _reached_keys(centers[has_cube][::step], sigmas[has_cube][::step], low, side)
    sample = keys[::step]
    occupied_keys = np.unique(np.concatenate([sample, *reached_keys]))
    # 3. Groups of cubes that touch, and the number of Gaussians in each.
    groups = _groups(occupied_keys)
    counts = np.bincount(groups[np.searchsorted(occupied_keys, sample)], minlength=groups.max() + 1)
    retained_keys = occupied_keys[(counts >= _MIN_GROUP_SHARE * len(no_floaters[::step]))[groups]]
    if step > 1:  # the sample may miss cubes at the object's edge
        retained_keys = np.unique((retained_keys[:, None] + _NEIGHBOURS).ravel())
    if not len(retained_keys):
        return no_floaters
    result = ~has_cube
    offsets = np.minimum(np.searchsorted(retained_keys, keys), len(retained_keys) - 1)
    result[has_cube] = retained_keys[offsets] != keys
    return np.asarray(result)


def _keys(cube_coordinates: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Return one integer per cube, of 21 bits for each axis; neighbours differ by a constant."""
    x, y, z = (cube_coordinates.astype(np.int64) + _GRID_SIZE + 2 * _MAX_CUBES_PER_GAUSSIAN).T
    return np.asarray((x << 42) + (y << 21) + z)


def _reached_keys(
    centers: Float64[np.ndarray, "n 3"],
    sigmas: Float64[np.ndarray, "n 3"],
    low: Float64[np.ndarray, "3"],
    side: float,
) -> list[Int64[np.ndarray, " m"]]:
    """Return the cubes along the axes within two standard deviations of large Gaussians."""
    keys = []
    for axis, step in itertools.product(range(3), range(1, _MAX_CUBES_PER_GAUSSIAN + 1)):
        reach = _LINK_SIGMAS * sigmas[:, axis]
        is_large = reach > (step - 1) * side
        if step == 1:
            is_large = reach > side / 2
        if not is_large.any():
            continue
        offsets = np.zeros((int(is_large.sum()), 3))
        offsets[:, axis] = np.minimum(step * side, reach[is_large])
        keys += [
            _keys(np.floor((centers[is_large] + sign * offsets - low) / side)) for sign in (-1, 1)
        ]
    return keys


def _groups(keys: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, " m"]:
    """Return the number of the group of each cube, of ascending keys: cubes that touch are one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    first_indices, second_indices = [], []
    for step in _NEIGHBOURS[_NEIGHBOURS > 0]:  # the other neighbours find this cube
        offsets = np.minimum(np.searchsorted(keys, keys + step), len(keys) - 1)
        neighbour_pairs = np.flatnonzero(keys[offsets] == keys + step)
        first_indices.append(neighbour_pairs)
        second_indices.append(offsets[neighbour_pairs])
    rows, columns = np.concatenate(first_indices), np.concatenate(second_indices)
    links = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(len(keys),) * 2)
    return np.asarray(connected_components(links, directed=False)[1], np.int64)

"""Clusters the SH coefficients of all splats into a palette for a SOG file.

A tree splits the splats along the principal axis of a cluster, largest squared error first; its
leaves, in order, are the first entries, unless rows of the scene do better. Lloyd's iterations
(1957) then move each entry to the mean of its splats. A splat looks for its entry in the blocks
of neighbouring leaves only, which finds nearly always the nearest one of 65,536 at a fraction of
the cost. Neighbours in the palette look alike, so that its image and the image of the labels
compress well.
"""

from typing import Final

import numpy as np
from jaxtyping import Float32, Float64, Int64

_MAX_TRAINING_ROWS: Final = 1 << 19
_TRIAL_ROUNDS: Final = 2
_LLOYD_ROUNDS: Final = 2
_POWER_STEPS: Final = 2
_MIN_SEARCHED_ENTRIES: Final = 3072  # the entries, at least, of the blocks in which a splat looks
_CHUNK_ROWS: Final = 1 << 12
_FULL_CLUSTER_SPLIT_DIVISOR: Final = (
    8  # every cluster is split while the tree has fewer than 1/8 of its leaves
)
_SPLIT_DIVISOR: Final = 3  # later, the worst third

Rows = Float32[np.ndarray, "n d"]


def training_step(count: int) -> int:
    """Return the row stride that samples at most half a million splats to compute an SH palette."""
    return -(-count // _MAX_TRAINING_ROWS)


def make_palette(rows: Rows, size: int) -> Rows:
    """Return at most ``size`` palette entries that quantise rows of SH with small squared error."""
    # Real scenes have clusters, which a tree finds; noise has none, and rows of it start better.
    evenly_spaced_rows = rows[np.linspace(0, len(rows) - 1, min(size, len(rows))).astype(np.int64)]
    starts = [_split_clusters(candidate, size) for candidate in (rows, evenly_spaced_rows)]
    rounds = [_refined_palette(rows, palette, _TRIAL_ROUNDS) for palette in starts]
    palette, _ = min(rounds, key=lambda entry: entry[1])
    return _refined_palette(rows, palette, _LLOYD_ROUNDS)[0]


def _refined_palette(rows: Rows, palette: Rows, rounds: int) -> tuple[Rows, float]:
    """Return the SH palette after Lloyd iterations, and the squared error before the last one."""
    error = 0.0
    for _ in range(rounds):
        labels = nearest_entries(rows, palette)
        error = _error(rows, palette, labels)
        palette = _updated_palette_means(rows, labels, palette)
    return palette, error


def _error(rows: Rows, palette: Rows, labels: Int64[np.ndarray, " n"]) -> float:
    parts = (slice(start, start + _CHUNK_ROWS) for start in range(0, len(rows), _CHUNK_ROWS))
    return float(sum(np.square(rows[part] - palette[labels[part]]).sum() for part in parts))


def nearest_entries(values: Rows, palette: Rows) -> Int64[np.ndarray, " n"]:
    """Return the index of the palette entry that is nearest, or nearly so, to each row of SH.

    Only the blocks of entries around the nearest block are searched.
    """
    block = max(1, round(len(palette) ** 0.5))
    starts = np.arange(0, len(palette), block)
    centres = _group_means(palette, starts)
    members = [np.arange(start, min(start + block, len(palette))) for start in starts]
    neighbour_blocks = np.argsort(_squared_distances(centres, centres), axis=1, kind="stable")
    neighbour_blocks = neighbour_blocks[:, : -(-_MIN_SEARCHED_ENTRIES // block)]
    parts = (values[start : start + _CHUNK_ROWS] for start in range(0, len(values), _CHUNK_ROWS))
    nearest_block = np.concatenate(
        [_squared_distances(part, centres).argmin(axis=1) for part in parts]
    )
    order = np.argsort(nearest_block, kind="stable")
    block_starts = np.searchsorted(nearest_block[order], np.arange(len(starts) + 1))
    labels = np.empty(len(values), np.int64)
    for index, blocks in enumerate(neighbour_blocks):
        candidates = np.concatenate([members[neighbour] for neighbour in np.sort(blocks)])
        entries = palette[candidates]
        for start in range(block_starts[index], block_starts[index + 1], _CHUNK_ROWS):
            rows = order[start : min(start + _CHUNK_ROWS, block_starts[index + 1])]
            labels[rows] = candidates[_squared_distances(values[rows], entries).argmin(axis=1)]
    return labels


def _split_clusters(rows: Rows, size: int) -> Rows:
    """Split clusters of SH rows until there are ``size`` clusters, or none can be split."""
    starts = np.zeros(1, np.int64)
    while len(starts) < size:
        counts = np.diff(starts, append=len(rows))
        label = np.repeat(np.arange(len(starts)), counts)
        centred = rows - _group_means(rows, starts)[label]
        variances = np.add.reduceat(centred * centred, starts, axis=0)
        error = variances.sum(axis=1)
        candidates = np.flatnonzero((counts > 1) & (error > 0))
        if not len(candidates):
            break
        divisor = 1 if len(starts) < size // _FULL_CLUSTER_SPLIT_DIVISOR else _SPLIT_DIVISOR
        most = min(-(-len(candidates) // divisor), size - len(starts))
        split_labels = candidates[np.argsort(-error[candidates], kind="stable")[:most]]
        is_split = np.isin(np.arange(len(starts)), split_labels)
        is_positive_side = (_random_projections(centred, variances, starts, label) > 0) & is_split[
            label
        ]
        new_labels = label * 2 + is_positive_side
        order = np.argsort(new_labels, kind="stable")
        rows, cluster_count = rows[order], len(starts)
        starts = np.flatnonzero(np.diff(new_labels[order], prepend=-1))
        if len(starts) == cluster_count:  # only rounding separates the rows of these clusters
            break
    return _group_means(rows, starts)


def _random_projections(
    centred: Rows, variances: Rows, starts: Int64[np.ndarray, " k"], label: Int64[np.ndarray, " n"]
) -> Float32[np.ndarray, " n"]:
    """Project each row onto the principal axis of its cluster, found by power iteration."""
    axis = np.eye(variances.shape[1], dtype=np.float32)[variances.argmax(axis=1)]
    for _ in range(_POWER_STEPS):
        projections = np.einsum("nd,nd->n", centred, axis[label])
        axis = np.add.reduceat(centred * projections[:, None], starts, axis=0)
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        axis /= np.where(length > 0, length, 1)
    return np.asarray(np.einsum("nd,nd->n", centred, axis[label]))


def _group_means(rows: Rows, starts: Int64[np.ndarray, " k"]) -> Rows:
    counts = np.diff(starts, append=len(rows))
    return np.asarray(np.add.reduceat(rows, starts, axis=0) / counts[:, None], np.float32)


def _updated_palette_means(rows: Rows, labels: Int64[np.ndarray, " n"], palette: Rows) -> Rows:
    """Return each palette entry as the mean of its rows; entries without rows stay unchanged."""
    order = np.argsort(labels, kind="stable")
    starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
    updated_palette = palette.copy()
    updated_palette[labels[order][starts]] = _group_means(rows[order], starts)
    return updated_palette


def _squared_distances(
    rows: Rows, entries: Rows
) -> Float32[np.ndarray, "n k"] | Float64[np.ndarray, "n k"]:
    """Return squared distances of SH rows to palette entries, minus each row's squared length."""
    distances = rows @ (-2 * entries).T
    distances += np.square(entries).sum(axis=1)
    return np.asarray(distances)

"""Converts the 32-bit words of rendered GPU images to a frame."""

__all__ = ["frame_of"]

import numpy as np
from jaxtyping import Float32, Int64, UInt32

from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import ABSENT
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import NOTHING, Frame
from gsgen.runtime.scene.scene import Scene


def frame_of(
    scene: Scene,
    camera: Camera,
    counts: np.ndarray,
    images: dict[str, np.ndarray],
    opacity_behind: float,
) -> Frame:
    """Convert the 32-bit words of rendered GPU images to a frame."""
    color, pick, normal = (
        images[name].view(np.float32) if name in images else None
        for name in ("color", "depth", "normal")
    )
    covered = next(image for image in (color, pick, normal) if image is not None)
    alpha = covered[..., 3].copy()
    if color is not None:
        color[..., 3] += (1 - alpha) * np.float32(opacity_behind)
    return Frame(
        rgba=color,
        alpha=alpha,
        depth=None if pick is None else _mean_depth(pick),
        median_depth=None if pick is None else _median_depth(pick),
        ids=None if pick is None else _ids(images["depth"][..., 2], scene),
        normal=None if normal is None else _in_world(normal[..., :3], camera),
        visible=int(counts[Counts.VISIBLE]),
        pairs=int(counts[Counts.PAIRS]),
        color_space=scene.color_space,
    )


def _mean_depth(pick: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w"]:
    total, alpha = pick[..., 0], pick[..., 3]
    nothing = np.full(alpha.shape, np.inf, np.float32)
    return np.asarray(np.divide(total, alpha, out=nothing, where=alpha > 0))


def _median_depth(pick: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w"]:
    median = pick[..., 1]
    return np.asarray(np.where(median > 0, median, np.float32(np.inf)))


def _ids(words: UInt32[np.ndarray, "h w"], scene: Scene) -> Int64[np.ndarray, "h w"]:
    """Convert splat ids, which skip weighted-sum splat sets, to row indices of the whole scene."""
    ids = np.where(words == ABSENT, NOTHING, words.astype(np.int64))
    weighted = [splat_set.weighted is not None for splat_set in scene.sets]
    summed = np.array([*weighted, *(False for _ in scene.pools)], bool)
    if not summed.any() or summed.all():
        return np.asarray(ids)
    own_sizes = [len(splat_set.data) for splat_set in scene.sets]
    sizes = np.array([*own_sizes, *(len(pooled.pool) for pooled in scene.pools)])
    first, set_sizes = (np.cumsum(sizes) - sizes)[~summed], sizes[~summed]
    start = np.cumsum(set_sizes) - set_sizes
    set_index = np.searchsorted(start, ids, side="right") - 1
    return np.asarray(np.where(ids < 0, NOTHING, ids + (first - start)[set_index]))


def _in_world(normal: Float32[np.ndarray, "h w 3"], camera: Camera) -> Float32[np.ndarray, "h w 3"]:
    """Return normals in camera space as unit vectors in world space; zeros stay zeros."""
    turned = normal @ camera.view[:3, :3].astype(np.float32)  # rows times R are Rᵀ n
    size = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.asarray(np.divide(turned, size, out=np.zeros_like(turned), where=size > 0))

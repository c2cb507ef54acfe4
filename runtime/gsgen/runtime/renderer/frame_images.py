"""Reads a frame's counters and images back from the GPU, and converts them to a frame."""

__all__ = ["CountedItems", "FrameReadback", "frame_of"]

from collections.abc import Mapping, Sequence
from typing import Literal, final

import numpy as np
from jaxtyping import Float32, Int64, UInt32

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.readback import StagingBuffers
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.renderer.bands import CountsAndImages
from gsgen.runtime.renderer.frame_counts import frame_counts
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import NOTHING, Frame
from gsgen.runtime.scene.scene import Scene

CountedItems = Literal["all", "splats", "cells"]
"""Whose counters count: of all, of depth-sorted splats alone, or of weighted sums alone."""


@final
class FrameReadback:
    """The copy of a frame's GPU counters and images that the host reads.

    Frames of one plan that are in flight at the same time need one each.

    Args:
        device: Device of the buffers.
        kernels: Kernels of the device.
        counters: Buffers of counters: of depth-sorted splats, and perhaps of weighted sums.
        images: Buffers of images, by output.
        size: Width and height of the images, in pixels.
        origins: Index in the scene of each Gaussian on the GPU; None if both orders agree.

    Attributes:
        images: Buffers of images, by output.
        staging: Receives the copies.
    """

    def __init__(
        self,
        device: Device,
        kernels: Kernels,
        counters: Mapping[str, Buffer],
        images: Mapping[str, Buffer],
        size: tuple[int, int],
        origins: UInt32[np.ndarray, " n"] | None,
    ) -> None:
        self._device, self._kernels = device, kernels
        self._counter_names, self.images = list(counters), images
        self._image_size, self._origins = size, origins
        self.staging = StagingBuffers(device, {**counters, **images})

    def collect(self, *, fetch: bool = True, counted: CountedItems = "all") -> CountsAndImages:
        """Wait for the GPU to finish a frame; return its counters and images of 32-bit words.

        Args:
            fetch: Whether images are read.
            counted: Whose counters are added up.

        Raises:
            CapacityExceeded: More splats are drawn than the device dispatches at once.
        """
        names = [*self._counter_names, *(self.images if fetch else ())]
        arrays_by_name = self.staging.read(dict.fromkeys(names, np.uint32))
        counter_parts = [arrays_by_name.pop(name) for name in self._counter_names]
        if counted == "cells":
            counter_parts[0] = counting.initial(0, int(counter_parts[0][Counts.PAIR_CAPACITY]))
        if counted == "splats":
            counter_parts = counter_parts[:1]
        counts = frame_counts(self._device, self._kernels, counter_parts)
        width, height = self._image_size
        images = {
            # Rows of a copied texture are padded.
            name: id_words[: id_words.size // height * height].reshape(height, -1, 4)[:, :width]
            for name, id_words in arrays_by_name.items()
        }
        if self._origins is not None and "depth" in images:
            ids = images["depth"][..., 2]
            has_id = ids != NO_ID
            ids[has_id] = self._origins[ids[has_id]]
        return counts, images


def frame_of(
    scene: Scene,
    eyes: Sequence[Camera],
    counts: np.ndarray,
    images: dict[str, np.ndarray],
    opacity_behind: float,
) -> Frame:
    """Convert the 32-bit words of rendered GPU images, side by side for two eyes, to a frame."""
    color, depth_image, normal = (
        images[name].view(np.float32) if name in images else None
        for name in ("color", "depth", "normal")
    )
    first_image = next(image for image in (color, depth_image, normal) if image is not None)
    alpha = first_image[..., 3].copy()
    if color is not None:
        color[..., 3] += (1 - alpha) * np.float32(opacity_behind)
    return Frame(
        rgba=color,
        alpha=alpha,
        depth=None if depth_image is None else _mean_depth(depth_image),
        median_depth=None if depth_image is None else _median_depth(depth_image),
        ids=None if depth_image is None else _decode_ids(images["depth"][..., 2], scene),
        normal=None if normal is None else _world_normals(normal[..., :3], eyes),
        visible=int(counts[Counts.VISIBLE]),
        pairs=int(counts[Counts.PAIRS]),
        color_space=scene.color_space,
    )


def _mean_depth(depth_image: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w"]:
    total, alpha = depth_image[..., 0], depth_image[..., 3]
    infinite_depth = np.full(alpha.shape, np.inf, np.float32)
    return np.asarray(np.divide(total, alpha, out=infinite_depth, where=alpha > 0))


def _median_depth(depth_image: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w"]:
    median = depth_image[..., 1]
    return np.asarray(np.where(median > 0, median, np.float32(np.inf)))


def _decode_ids(id_words: UInt32[np.ndarray, "h w"], scene: Scene) -> Int64[np.ndarray, "h w"]:
    """Convert splat ids, which skip weighted-sum splat sets, to row indices of the whole scene."""
    ids = np.where(id_words == NO_ID, NOTHING, id_words.astype(np.int64))
    weighted = [splat_set.weighted is not None for splat_set in scene.sets]
    is_weighted = np.array([*weighted, *(False for _ in scene.pools)], bool)
    if not is_weighted.any() or is_weighted.all():
        return np.asarray(ids)
    own_sizes = [len(splat_set.data) for splat_set in scene.sets]
    sizes = np.array([*own_sizes, *(len(pooled.pool) for pooled in scene.pools)])
    first, set_sizes = (np.cumsum(sizes) - sizes)[~is_weighted], sizes[~is_weighted]
    start = np.cumsum(set_sizes) - set_sizes
    set_index = np.searchsorted(start, ids, side="right") - 1
    return np.asarray(np.where(ids < 0, NOTHING, ids + (first - start)[set_index]))


def _world_normals(
    normal: Float32[np.ndarray, "h w 3"], eyes: Sequence[Camera]
) -> Float32[np.ndarray, "h w 3"]:
    """Return normals in the space of each eye as unit vectors in world space; zeros stay zeros."""
    parts = zip(np.split(normal, len(eyes), axis=1), eyes, strict=True)
    # Rows times R are Rᵀ n.
    turned_normals = np.concatenate(
        [part @ eye.view[:3, :3].astype(np.float32) for part, eye in parts], axis=1
    )
    size = np.linalg.norm(turned_normals, axis=-1, keepdims=True)
    return np.asarray(
        np.divide(turned_normals, size, out=np.zeros_like(turned_normals), where=size > 0)
    )

"""Runs a fixed-size network over a larger image, in overlapping tiles.

In overlaps, results are blended by weights that fall towards a tile's edges and sum to 1 at every
pixel. So there are no seams, and values that all tiles agree on stay unchanged.
"""

__all__ = ["Tile", "lay_tiles", "post_process", "run_tiled", "tile_weights"]

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Image = Float[np.ndarray, "1 c h w"]
Network = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True)
class Tile:
    """The first row and the first column of a tile in an image."""

    top: int
    left: int


def lay_tiles(image: tuple[int, int], tile: tuple[int, int], overlap: int) -> Iterator[Tile]:
    """Yield tiles that cover an image and share at least ``overlap`` pixels with neighbours.

    Sizes are height and width; the image is at least as large as a tile.
    """
    rows, columns = (_tile_starts(n, size, overlap) for n, size in zip(image, tile, strict=True))
    for top in rows:
        for left in columns:
            yield Tile(top, left)


def _tile_starts(length: int, size: int, overlap: int) -> list[int]:
    """Return the first pixel of each of evenly spaced tiles along one axis."""
    step, room = size - overlap, length - size
    count = 1 + max(0, -(-room // step))
    return [round(i * room / (count - 1)) for i in range(count)] if count > 1 else [0]


def tile_weights(
    image: tuple[int, int], tile: tuple[int, int], overlap: int
) -> list[tuple[Tile, Float[np.ndarray, "h w"]]]:
    """Return every tile of an image with the blend weight of each pixel, float64.

    A weight rises from a tile's edge over ``overlap`` pixels. The weights of all tiles sum to 1
    at each pixel; a pixel of one tile alone has weight 1.
    """
    weight_ramp = np.outer(_blend_ramp(tile[0], overlap), _blend_ramp(tile[1], overlap))
    tiles = list(lay_tiles(image, tile, overlap))
    total = np.zeros(image)
    for corner in tiles:
        total[_tile_slices(corner, tile)] += weight_ramp
    return [(corner, weight_ramp / total[_tile_slices(corner, tile)]) for corner in tiles]


def _blend_ramp(size: int, overlap: int) -> Float[np.ndarray, " n"]:
    """Return a tile's blend weights along an axis: 1 in the middle, just above 0 at the ends."""
    edge_distance = np.minimum(np.arange(1, size + 1), np.arange(size, 0, -1))
    return np.minimum(edge_distance / (overlap + 1), 1.0)


def _tile_slices(tile: Tile, size: tuple[int, int]) -> tuple[slice, slice]:
    rows, columns = (slice(tile.top, tile.top + size[0]), slice(tile.left, tile.left + size[1]))
    return rows, columns


def run_tiled(image: Image, network: Network, tile: tuple[int, int], overlap: int = 32) -> Image:
    """Run a network over an image tile by tile, and blend the results.

    An image that is smaller than a tile is padded with its edge pixels, and cropped afterwards.

    Args:
        image: float32 or float16, channels first.
        network: Takes and returns one tile, [1, C, tile height, tile width]; channels may differ.
        tile: Height and width of a tile.
        overlap: The least number of pixels that neighbours share, below half a tile's sides.

    Returns:
        The result, in the dtype of the network's output.

    Raises:
        ConfigInvalid: The overlap does not fit the tile, or a size is invalid.
    """
    _require_tile_size(image, tile, overlap)
    height, width = image.shape[2:]
    missing = [max(0, size - n) for size, n in zip(tile, (height, width), strict=True)]
    padded = np.pad(image, ((0, 0), (0, 0), (0, missing[0]), (0, missing[1])), mode="edge")
    total: np.ndarray | None = None
    dtype = image.dtype
    for corner, weight in tile_weights(padded.shape[2:], tile, overlap):
        part = (slice(None), slice(None), *_tile_slices(corner, tile))
        result = np.asarray(network(np.ascontiguousarray(padded[part])))
        if result.ndim != 4 or result.shape[0] != 1 or result.shape[2:] != tile:
            message = f"the network returned {list(result.shape)}, expected [1, channels, {tile[0]}, {tile[1]}]"
            raise ConfigInvalid(message, where="tile")
        if total is None:
            dtype = result.dtype
            total = np.zeros((1, result.shape[1], *padded.shape[2:]))
        total[part] += weight * result
    assert total is not None
    return np.asarray(total[:, :, :height, :width].astype(dtype))


def _require_tile_size(image: np.ndarray, tile: tuple[int, int], overlap: int) -> None:
    if image.ndim != 4 or image.shape[0] != 1 or 0 in image.shape:
        message = f"the image is {list(image.shape)}, expected [1, channels, height, width]"
        raise ConfigInvalid(message, where="image")
    if min(tile) < 1 or not 0 <= overlap <= (min(tile) - 1) // 2:
        max_overlap = max(0, (min(tile) - 1) // 2)
        message = f"is {overlap}, expected 0 to {max_overlap} for tiles of {tile[0]} × {tile[1]}"
        raise ConfigInvalid(message, where="overlap")


def post_process(
    session: "InferenceSession",
    image: Image,
    extra_inputs: Mapping[str, np.ndarray] | None = None,
    *,
    name: str = "image",
    overlap: int = 32,
) -> Image:
    """Run a post-process model over an image of any size.

    A model of fixed size runs tile by tile; one of open size sees the whole image at once.

    Args:
        session: An ``onnxruntime.InferenceSession``.
        image: Image in the model's own range of values.
        extra_inputs: Values of the model's other inputs.
        name: Name of the image input.
        overlap: Pixels that tiles share; fewer where tiles are small.

    Raises:
        ConfigInvalid: The model has no such input, or expects another number of channels.
    """
    by_name = {entry.name: entry for entry in session.get_inputs()}
    if name not in by_name:
        message = f"the model has no input {name!r}, expected one of {', '.join(by_name)}"
        raise ConfigInvalid(message, where="image")
    channels, *size = by_name[name].shape[1:]
    if isinstance(channels, int) and channels != image.shape[1]:
        message = f"the image has {image.shape[1]} channels, expected {channels}"
        raise ConfigInvalid(message, where="image")
    dtype = np.float16 if "float16" in by_name[name].type else np.float32

    def run(part: np.ndarray) -> np.ndarray:
        input_feeds = dict(extra_inputs or {}) | {name: part.astype(dtype)}
        return np.asarray(session.run(None, input_feeds)[0])

    if not all(isinstance(side, int) for side in size):
        return run(image)
    height, width = size
    return run_tiled(image, run, (height, width), min(overlap, (min(size) - 1) // 2))

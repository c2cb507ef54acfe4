"""Runs a fixed-size network over a larger image, in overlapping tiles.

In overlaps, results are blended by weights that fall towards a tile's edges and sum to 1 at every
pixel. So there are no seams, and values that all tiles agree on stay unchanged.
"""

__all__ = ["Tile", "lay_tiles", "post_process", "run_tiled", "tile_weights"]

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
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
    image: tuple[int, int], tile: tuple[int, int], overlap: int, scale: int = 1
) -> list[tuple[Tile, Float[np.ndarray, "h w"]]]:
    """Return every tile of an image with the blend weight of each pixel of its result, float64.

    Results are ``scale`` times as high and wide as tiles. A weight rises from a result's edge over
    the pixels of ``overlap``. The weights of all tiles sum to 1 at each pixel; a pixel of one tile
    alone has weight 1.
    """
    sides = [_blend_ramp(scale * side, scale * overlap) for side in tile]
    weight_ramp = np.outer(*sides)
    tiles = list(lay_tiles(image, tile, overlap))
    total = np.zeros((scale * image[0], scale * image[1]))
    parts = [_tile_slices(corner, tile, scale) for corner in tiles]
    for part in parts:
        total[part] += weight_ramp
    return [(corner, weight_ramp / total[part]) for corner, part in zip(tiles, parts, strict=True)]


def _blend_ramp(size: int, overlap: int) -> Float[np.ndarray, " n"]:
    """Return a tile's blend weights along an axis: 1 in the middle, just above 0 at the ends."""
    edge_distance = np.minimum(np.arange(1, size + 1), np.arange(size, 0, -1))
    return np.minimum(edge_distance / (overlap + 1), 1.0)


def _tile_slices(tile: Tile, size: tuple[int, int], scale: int = 1) -> tuple[slice, slice]:
    """Return the rows and columns of a tile in an image that is ``scale`` times as large."""
    rows, columns = (
        slice(scale * first, scale * (first + side))
        for first, side in zip((tile.top, tile.left), size, strict=True)
    )
    return rows, columns


def run_tiled(image: Image, network: Network, tile: tuple[int, int], overlap: int = 32) -> Image:
    """Run a network over an image tile by tile, and blend the results.

    An image that is smaller than a tile is padded with its edge pixels, and cropped afterwards.

    Args:
        image: float32 or float16, channels first.
        network: Takes one tile, [1, C, tile height, tile width], and returns one of that size or a
            multiple; channels may differ.
        tile: Height and width of a tile.
        overlap: The least number of pixels that neighbours share, below half a tile's sides.

    Returns:
        The result, in the dtype of the network's output, as many times larger as its tiles.

    Raises:
        ConfigInvalid: The overlap does not fit the tile, or a size is invalid.
    """
    _require_tile_size(image, tile, overlap)
    height, width = image.shape[2:]
    missing = [max(0, size - n) for size, n in zip(tile, (height, width), strict=True)]
    padded = np.pad(image, ((0, 0), (0, 0), (0, missing[0]), (0, missing[1])), mode="edge")
    results = (
        np.asarray(network(np.ascontiguousarray(padded[:, :, rows, columns])))
        for rows, columns in (
            _tile_slices(corner, tile) for corner in lay_tiles(padded.shape[2:], tile, overlap)
        )
    )
    first = next(results)
    scale = max(1, first.shape[2] // tile[0]) if first.ndim == 4 else 1
    enlarged_tile = (scale * tile[0], scale * tile[1])
    weights = tile_weights(padded.shape[2:], tile, overlap, scale)
    total = np.zeros(
        (1, first.shape[min(1, first.ndim - 1)], *(scale * side for side in padded.shape[2:]))
    )
    for result, (corner, weight) in zip(chain([first], results), weights, strict=True):
        if result.ndim != 4 or result.shape[0] != 1 or result.shape[2:] != enlarged_tile:
            message = (
                f"the network returned {list(result.shape)}, expected [1, channels, {tile[0]}, "
                f"{tile[1]}], or a multiple of this size"
            )
            raise ConfigInvalid(message, where="tile")
        rows, columns = _tile_slices(corner, tile, scale)
        total[:, :, rows, columns] += weight * result
    return np.asarray(total[:, :, : scale * height, : scale * width].astype(first.dtype))


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

    A model of fixed size runs tile by tile; one of open size sees the whole image at once. The
    result of an enlarging model is larger than the image by the model's scale.

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

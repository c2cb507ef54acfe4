"""Post-process images that are larger than a model takes, in overlapping tiles.

Where tiles overlap, results are blended by weights that fall towards a tile's edges and sum to 1
at every pixel, so that no seam shows and what every tile agrees on stays as it is.
"""

__all__ = ["Tile", "lay_tiles", "post_process", "run_tiled", "tile_weights"]

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import ConfigInvalid

Image = Float[np.ndarray, "1 c h w"]
Network = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True)
class Tile:
    """A part of an image.

    Attributes:
        top: First row.
        left: First column.
    """

    top: int
    left: int


def lay_tiles(
    image: tuple[int, int], tile: tuple[int, int], overlap: int
) -> Iterator[Tile]:
    """Yield tiles of one size that cover an image; the last ones end with it.

    Args:
        image: Height and width, at least those of a tile.
        tile: Height and width.
        overlap: How many pixels neighbours share at least.
    """
    rows, columns = (_starts(n, size, overlap) for n, size in zip(image, tile, strict=True))
    for top in rows:
        for x in columns:
            yield Tile(top, x)


def _starts(length: int, size: int, overlap: int) -> list[int]:
    """Return where tiles begin along one axis, as evenly as they can."""
    step = size - overlap
    count = 1 + max(0, -(-(length - size) // step))
    room = length - size
    return [round(i * room / (count - 1)) for i in range(count)] if count > 1 else [0]


def tile_weights(
    image: tuple[int, int], tile: tuple[int, int], overlap: int
) -> list[tuple[Tile, Float[np.ndarray, "h w"]]]:
    """Return every tile with the weight of its pixels, float64; they sum to 1 at each pixel.

    A weight rises from a tile's edge over ``overlap`` pixels; at the edges of the image, where
    there is no neighbour, all that is left is the tile itself.
    """
    ramp = np.outer(_ramp(tile[0], overlap), _ramp(tile[1], overlap))
    tiles = list(lay_tiles(image, tile, overlap))
    total = np.zeros(image)
    for laid in tiles:
        total[_part(laid, tile)] += ramp
    return [(laid, ramp / total[_part(laid, tile)]) for laid in tiles]


def _ramp(size: int, overlap: int) -> Float[np.ndarray, " n"]:
    """Return 1 in the middle, falling to just above 0 at both ends."""
    from_end = np.minimum(np.arange(1, size + 1), np.arange(size, 0, -1))
    return np.minimum(from_end / (overlap + 1), 1.0)


def _part(tile: Tile, size: tuple[int, int]) -> tuple[slice, slice]:
    rows, columns = (
        slice(tile.top, tile.top + size[0]),
        slice(tile.left, tile.left + size[1]),
    )
    return rows, columns


def run_tiled(
    image: Image, network: Network, tile: tuple[int, int], overlap: int = 32
) -> Image:
    """Run a network over an image tile by tile, and blend what comes out.

    An image that is smaller than a tile is continued by its edge, and cut again.

    Args:
        image: float32 or float16, channels first.
        network: Takes and returns one tile, [1, C, tile height, tile width]; channels may differ.
        tile: Height and width of a tile.
        overlap: Pixels that neighbours share at least, below half a tile's sides.

    Returns:
        The image, in the dtype that the network returns.

    Raises:
        ConfigInvalid: The overlap does not fit the tile, or sizes are none.
    """
    _require(image, tile, overlap)
    height, width = image.shape[2:]
    missing = [max(0, size - n) for size, n in zip(tile, (height, width), strict=True)]
    padded = np.pad(image, ((0, 0), (0, 0), (0, missing[0]), (0, missing[1])), mode="edge")
    total: np.ndarray | None = None
    dtype: Any = None
    for laid, weight in tile_weights(padded.shape[2:], tile, overlap):
        part = (slice(None), slice(None), *_part(laid, tile))
        result = np.asarray(network(np.ascontiguousarray(padded[part])))
        if result.ndim != 4 or result.shape[0] != 1 or result.shape[2:] != tile:
            message = f"the network returned {list(result.shape)} for a tile of {tile[0]} × {tile[1]}"
            raise ConfigInvalid(message, where="tile")
        if total is None:
            dtype = result.dtype
            total = np.zeros((1, result.shape[1], *padded.shape[2:]))
        total[part] += weight * result
    assert total is not None
    return np.asarray(total[:, :, :height, :width].astype(dtype))


def _require(image: np.ndarray, tile: tuple[int, int], overlap: int) -> None:
    if image.ndim != 4 or image.shape[0] != 1 or 0 in image.shape:
        message = f"the image is {list(image.shape)}, wanted [1, channels, height, width]"
        raise ConfigInvalid(message, where="image")
    if min(tile) < 1 or not 0 <= overlap <= (min(tile) - 1) // 2:
        message = f"an overlap of {overlap} does not fit tiles of {tile[0]} × {tile[1]}"
        hint = f"Give 0 to {max(0, (min(tile) - 1) // 2)}."
        raise ConfigInvalid(message, where="overlap", hint=hint)


def post_process(
    session: Any,
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
        image: In the model's own range of values.
        extra_inputs: What the model takes besides the image.
        name: Of the input that takes the image.
        overlap: Pixels that tiles share; less where tiles are small.

    Raises:
        ConfigInvalid: The model has no such input, or takes another number of channels.
    """
    by_name = {entry.name: entry for entry in session.get_inputs()}
    if name not in by_name:
        message = f"there is no input {name!r}; there are {', '.join(by_name)}"
        raise ConfigInvalid(message, where="image")
    channels, *size = by_name[name].shape[1:]
    if isinstance(channels, int) and channels != image.shape[1]:
        message = f"the image has {image.shape[1]} channels, and the model takes {channels}"
        raise ConfigInvalid(message, where="image")
    dtype = np.float16 if "float16" in by_name[name].type else np.float32

    def run(part: np.ndarray) -> np.ndarray:
        feeds = dict(extra_inputs or {}) | {name: part.astype(dtype)}
        return np.asarray(session.run(None, feeds)[0])

    if not all(isinstance(side, int) for side in size):
        return run(image)
    height, width = size
    return run_tiled(image, run, (height, width), min(overlap, (min(size) - 1) // 2))

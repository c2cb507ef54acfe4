"""NumPy references of the tile kernels: what each shader must return."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt32

from gsgen.contract.spec import layout
from gsgen.runtime.kernels.shared.shader import MAX_ALPHA, NOWHERE, TILE, WINDOW_HEIGHT
from gsgen.runtime.kernels.tiles.blend_tiles import MIN_TRANSMITTANCE
from gsgen.runtime.kernels.tiles.blend_wsr import MIN_WSR_TRANSMITTANCE
from references.projection import Projected

_WINDOW_WIDTH = 4  # tiles
_WINDOW_BITS = WINDOW_HEIGHT * _WINDOW_WIDTH


def touched_reference(
    mean: Float[np.ndarray, "2"],
    conic: Float[np.ndarray, "3"],
    strength: float,
    size: tuple[int, int],
    period: float = 0.0,
    tile: int = TILE,
) -> Bool[np.ndarray, "rows columns"]:
    """Return the mask of image tiles that have a pixel which a splat reaches.

    Args:
        mean: Centre of the splat, in pixels.
        conic: Inverse 2D covariance: xx, xy, yy.
        strength: Logarithm of the opacity over CULL_OPACITY.
        size: Width and height of the image, in pixels.
        period: Pixels of a full turn of a panorama; 0 for other images.
        tile: Edge of a tile, in pixels.
    """
    horizontal_coverage, down = (-(-side // tile) for side in size)
    dx = np.arange(size[0]) + 0.5 - mean[0]
    if period:
        dx = dx - period * np.round(dx / period)
    dy = np.arange(size[1])[:, None] + 0.5 - mean[1]
    power = 0.5 * (conic[0] * dx**2 + conic[2] * dy**2) + conic[1] * dx * dy
    is_window_pixel = np.zeros((down * tile, horizontal_coverage * tile), bool)
    is_window_pixel[: size[1], : size[0]] = power <= strength
    return np.asarray(
        is_window_pixel.reshape(down, tile, horizontal_coverage, tile).any(axis=(1, 3))
    )


def ranges_reference(tiles: UInt32[np.ndarray, " n"], count: int) -> UInt32[np.ndarray, "t 2"]:
    """Return the range of splat-tile pairs of each tile: the reference of ``tile_ranges.wgsl``."""
    tile_ids = np.arange(count)
    ends = [np.searchsorted(tiles, tile_ids, side) for side in ("left", "right")]
    bounds = np.stack(ends, axis=1)
    return np.where(bounds[:, :1] < bounds[:, 1:], bounds, 0).astype(np.uint32)


def window_tiles(word: int, horizontal_coverage: int) -> list[int]:
    """Return the image tiles that a packed word encodes, in order: as ``tile_window.wgsl`` does.

    Args:
        word: The word, which is not ABSENT.
        across: Number of tiles in a row of the image.
    """
    first, touched_bits = word >> _WINDOW_BITS, word & ((1 << _WINDOW_BITS) - 1)
    bits = [bit for bit in range(_WINDOW_BITS) if touched_bits >> bit & 1]
    return [
        first + bit // _WINDOW_WIDTH * horizontal_coverage + bit % _WINDOW_WIDTH for bit in bits
    ]


def blend_reference(
    splats: Projected,
    origin: Float[np.ndarray, "2"],
    size: tuple[int, int],
    layers: Sequence[tuple[Float[np.ndarray, "h w 4"], Float[np.ndarray, "h w"]]] = (),
) -> Float[np.ndarray, "h w 4"]:
    """Blend sorted splats in float64: the reference of ``blend_tiles.wgsl``.

    Args:
        splats: Drawn splats, nearest first.
        origin: Origin of the means, in pixels of the image.
        size: Width and height of the image, in pixels.
        layers: Colours and depths of each layer, see ``blend_tiles.Layers``.
    """
    width, height = size
    x = np.arange(width) + 0.5 - origin[0]
    y = np.arange(height)[:, None] + 0.5 - origin[1]
    through, live = np.ones((height, width)), np.ones((height, width), bool)
    color = np.zeros((height, width, 3))
    waiting = [depth < NOWHERE for _, depth in layers]

    def meet(reach: float) -> None:
        nonlocal through, color
        for number, (layer_color, depth) in enumerate(layers):
            is_covered = waiting[number] & (depth < reach)
            waiting[number] = waiting[number] & ~is_covered
            color = color + np.where(is_covered, through, 0)[..., None] * layer_color[..., :3]
            through = np.where(is_covered, through * (1 - layer_color[..., 3]), through)

    for mean, conic, strength, splat_color, far in zip(
        splats.mean, splats.conic, splats.strength, splats.color, splats.depth, strict=True
    ):
        meet(float(far))
        dx, dy = x - mean[0], y - mean[1]
        above = strength - 0.5 * (conic[0] * dx**2 + conic[2] * dy**2) - conic[1] * dx * dy
        alpha = np.minimum(layout.CULL_OPACITY * np.exp(above), MAX_ALPHA)
        after = through * (1 - alpha)
        live &= ~((above >= 0) & (after <= MIN_TRANSMITTANCE))
        drawn = live & (above >= 0)
        color += np.where(drawn, alpha * through, 0)[..., None] * splat_color
        through = np.where(drawn, after, through)
    meet(np.inf)
    return np.concatenate([color, 1 - through[..., None]], axis=-1)


def blend_wsr_reference(
    splats: Projected,
    radius: Float[np.ndarray, " n"],
    cells: Sequence[tuple[slice, Bool[np.ndarray, "rows columns"]]],
    factors: tuple[float, float],
    origin: Float[np.ndarray, "2"],
    size: tuple[int, int],
) -> Float[np.ndarray, "h w 4"]:
    """Blend one splat set without background in float64: the reference of ``blend_wsr.wgsl``.

    Args:
        splats: The Gaussians of the set, drawn or not.
        radius: Radius of the circle that bounds each Gaussian, in pixels.
        cells: The Gaussians and the tiles of each cell, nearest first.
        factors: Divisor of the opacity, and the weight of the background.
        origin: Origin of the means, in pixels of the image.
        size: Width and height of the image, in pixels.
    """
    (divisor, behind), (width, height) = factors, size
    x = np.arange(width) + 0.5 - origin[0]
    y = np.arange(height)[:, None] + 0.5 - origin[1]
    transmittance, total = np.ones((height, width)), np.zeros((height, width))
    color = np.zeros((height, width, 3))
    for members, tiles in cells:
        inside = np.kron(tiles, np.ones((TILE, TILE), bool))[:height, :width]
        visible_transmittance = np.where(
            inside & (transmittance >= MIN_WSR_TRANSMITTANCE), transmittance, 0
        )
        for i in np.flatnonzero(splats.drawn[members]) + members.start:
            dx, dy = x - splats.mean[i, 0], y - splats.mean[i, 1]
            xx, xy, yy = splats.conic[i]
            above = splats.strength[i] - 0.5 * (xx * dx**2 + yy * dy**2) - xy * dx * dy
            alpha = np.minimum(layout.CULL_OPACITY * np.exp(above), MAX_ALPHA) / divisor
            is_covered = (
                (visible_transmittance > 0) & (above >= 0) & (dx**2 + dy**2 <= radius[i] ** 2)
            )
            alpha = np.where(is_covered, alpha, 0)
            transmittance *= np.maximum(1 - alpha, 0)
            total += alpha * visible_transmittance
            color += (alpha * visible_transmittance)[..., None] * splats.color[i]
    backdrop = np.where(transmittance < MIN_WSR_TRANSMITTANCE, 0, behind * transmittance)
    scale = np.where(total > 0, total + backdrop, 1)
    return np.concatenate([color, total[..., None]], axis=-1) / scale[..., None]

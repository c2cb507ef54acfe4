"""What weighted sums must look like: in float64 NumPy, cell after cell, without the kernels' code.

It follows the specification's page on cells. Cells end at whole tiles and Gaussians at circles of
whole pixels, as in the renderer of Liu et al. 2025.
"""

__all__ = ["Sums", "Veil", "alone", "sums"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float, Int64

from gsgen.runtime.oracle.projection import Picture, across, colors, ellipses, normals
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet

_CULL: Final = 1 / 255
_MOST: Final = 0.99
_FINISHED: Final = 0.01
_TILE: Final = 16

# Within these shares of a threshold, float32 may decide otherwise.
_BAND: Final = 2e-3
_TIE: Final = 1e-12  # of a depth: two floats tell more, even where they are added up
_PIXELS: Final = 2e-3
_EQUAL: Final = 1e-4


@final
@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """What :func:`sums` makes, of every pixel.

    Attributes:
        color: Σ w c.
        normal: Σ w n, in world space.
        depth: Σ w z.
        total: Σ w.
        behind: Σ w b, b being the weight of what is behind.
        through: The light that passes.
        median_depth: Depth of what covers most in the cell where half of the light is gone.
        ids: Its place in the scene; −1 for none.
        fragile: Pixels where float32 may decide otherwise.
        fragile_median: The same for the median.
        visible: How many Gaussians reach a pixel's centre in a tile of their cell.
    """

    color: Float[np.ndarray, "h w 3"]
    normal: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    total: Float[np.ndarray, "h w"]
    behind: Float[np.ndarray, "h w"]
    through: Float[np.ndarray, "h w"]
    median_depth: Float[np.ndarray, "h w"]
    ids: Int64[np.ndarray, "h w"]
    fragile: Bool[np.ndarray, "h w"]
    fragile_median: Bool[np.ndarray, "h w"]
    visible: int

    @property
    def weight_behind(self) -> Float[np.ndarray, "h w"]:
        """The weight of what is behind; where nothing was summed, it is alone and 1 will do."""
        mean = np.divide(
            self.behind, self.total, out=np.ones_like(self.total), where=self.total > 0
        )
        return np.asarray(np.where(self.through < _FINISHED, 0, mean))

    @property
    def scale(self) -> Float[np.ndarray, "h w"]:
        """What sums are divided by."""
        return np.asarray(self.total + self.weight_behind * self.through)

    def veil(self) -> "Veil":
        """Return the translucent image that the sums are among other things."""
        some = self.total > 0
        return Veil(
            self.color / self.scale[..., None],
            self.total / self.scale,
            self.normal / self.scale[..., None],
            np.where(some, self.depth / np.where(some, self.total, 1), np.inf),
            self.fragile,
        )


@final
@dataclass(frozen=True, slots=True, eq=False)
class Veil:
    """A translucent image somewhere in space.

    Attributes:
        color: Colours multiplied by alpha.
        alpha: How much of what is behind it is covered.
        normal: Normals in world space, multiplied by alpha.
        depth: Mean depth; infinite where nothing is.
        fragile: Pixels where float32 may decide otherwise.
    """

    color: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    fragile: Bool[np.ndarray, "h w"]


@dataclass(frozen=True, slots=True, eq=False)
class _Cell:
    """A cell, and its Gaussians: one row of each array."""

    depth: float
    box: np.ndarray
    unsure: np.ndarray
    weighted: tuple[float, float]
    mean: np.ndarray
    conic: np.ndarray
    opacity: np.ndarray
    radius: np.ndarray
    ring: np.ndarray
    away: np.ndarray
    color: np.ndarray
    normal: np.ndarray
    place: np.ndarray


def alone(made: Sums, background: Sequence[float], published: bool = False) -> Picture:
    """Return the picture of sums with nothing but a background behind them.

    Args:
        made: The sums.
        background: Red, green, blue and alpha.
        published: Let the background keep its whole weight in the numerator.
    """
    veil, rest = made.veil(), made.weight_behind / made.scale
    share = rest if published else rest * made.through
    *color, opaque = background
    shown = veil.color + share[..., None] * np.array(color) * opaque
    size = np.linalg.norm(veil.normal, axis=-1, keepdims=True)
    return Picture(
        np.concatenate(
            [shown, (veil.alpha + (1 - veil.alpha) * opaque)[..., None]], axis=-1
        ),
        veil.depth,
        made.median_depth,
        made.ids,
        veil.normal / np.where(size > 0, size, 1),
        made.fragile,
        made.fragile_median | made.fragile,
        made.visible,
    )


def sums(
    scene: Scene, camera: Camera, walls: Float[np.ndarray, "h w"] | None = None
) -> Sums:
    """Sum the Gaussians of a scene's weighted sets.

    Args:
        scene: Sets that are not weighted are left out.
        camera: From where, and how large.
        walls: Depths beyond which nothing is seen; none where absent.
    """
    shape = (camera.height, camera.width)
    limit = np.full(shape, np.inf) if walls is None else walls
    first, cells = 0, []
    for one in scene.sets:
        if one.weighted is not None:
            cells += _cells(one, camera, first)
        first += len(one.data)
    cells.sort(key=lambda cell: cell.depth)  # stable
    state = _State(shape)
    before: _Cell | None = None
    touched = np.zeros(shape, bool)
    for cell in cells:
        gap = np.inf if before is None else cell.depth - before.depth
        tied = touched if 0 < gap < _TIE * cell.depth else np.zeros(shape, bool)
        touched = state.add(cell, camera, limit, tied)
        before = cell
    end = np.abs(state.through / _FINISHED - 1) <= _BAND
    return Sums(
        state.color,
        state.normal,
        state.depth,
        state.total,
        state.behind,
        state.through,
        state.median,
        state.ids,
        state.fragile | end,
        state.fragile_median,
        state.visible,
    )


class _State:
    """What all cells so far have left in each pixel."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.color, self.normal = np.zeros((*shape, 3)), np.zeros((*shape, 3))
        self.depth, self.total, self.behind = (np.zeros(shape) for _ in range(3))
        self.through, self.visible = np.ones(shape), 0
        self.median, self.ids = np.full(shape, np.inf), np.full(shape, -1)
        self.fragile, self.fragile_median = np.zeros(shape, bool), np.zeros(shape, bool)

    def add(
        self, cell: _Cell, camera: Camera, limit: np.ndarray, tied: np.ndarray
    ) -> np.ndarray:
        """Sum a cell, and say which pixels it touches."""
        divisor, behind = cell.weighted
        entered = self.through.copy()
        seen = cell.box & (entered >= _FINISHED)
        some, most = np.zeros_like(seen), np.zeros(seen.shape)
        second, strongest = np.zeros(seen.shape), np.full(seen.shape, -1)
        x, y = np.arange(camera.width) + 0.5, np.arange(camera.height)[:, None] + 0.5
        for k in range(len(cell.opacity)):
            dx = across(x, cell.mean[k, 0], camera)
            dy = y - cell.mean[k, 1]
            (a, b), (_, c) = cell.conic[k]
            bare = cell.opacity[k] * np.exp(-0.5 * (a * dx**2 + c * dy**2) - b * dx * dy)
            far = np.hypot(dx, dy)
            reached = (bare >= _CULL) & (far <= cell.radius[k])
            hit = reached & seen & (cell.away[k] <= limit)
            near = np.abs(bare / _CULL - 1) <= _BAND
            near |= np.abs(far - cell.radius[k]) <= cell.ring[k]
            near |= np.abs(cell.away[k] - limit) <= _EQUAL * cell.away[k]
            wide = bare >= _CULL * (1 - _BAND)
            around = cell.box | cell.unsure
            self.fragile |= wide & near & around & (entered >= _FINISHED * (1 - _BAND))
            self.fragile |= reached & cell.unsure
            alpha = np.where(hit, np.minimum(bare, _MOST) / divisor, 0)
            self.through *= np.maximum(1 - alpha, 0)
            amount = alpha * entered
            self.color += amount[..., None] * cell.color[k]
            self.normal += amount[..., None] * cell.normal[k]
            self.depth += amount * cell.away[k]
            self.total += amount
            self.behind += amount * behind
            some |= reached & cell.box
            self.visible += bool((reached & cell.box).any())
            more = alpha > most
            second = np.where(more, most, np.maximum(second, alpha))
            most = np.where(more, alpha, most)
            strongest = np.where(more, k, strongest)
        near_end = np.abs(entered / _FINISHED - 1) <= _BAND
        self.fragile |= some & (near_end | tied)
        halved = (entered >= 0.5) & (self.through < 0.5)
        self.median[halved] = cell.away[strongest[halved]]
        self.ids[halved] = cell.place[strongest[halved]]
        near_half = np.abs(self.through - 0.5) <= _BAND
        doubtful = halved & (second >= most * (1 - _EQUAL))
        self.fragile_median |= some & (near_half | doubtful)
        return some


def _cells(one: SplatSet, camera: Camera, first: int) -> list[_Cell]:
    """Return the cells of a set that have tiles in the image."""
    data, weighted = one.data, one.weighted
    assert data.cells is not None
    assert weighted is not None
    live = -(-data.count // data.per_cell)
    rows = data.cells[:live].astype(np.float64)
    found = ellipses(rows, one, camera)
    shown = found.sound & (found.depth > camera.near) & (rows[:, 3] > 0)
    splats = _splats(one, camera, first, rows[:, 3])
    belongs = splats["place"] - first
    made = []
    for number in np.flatnonzero(shown):
        box, unsure = _box(found.mean[number], found.wide[number], camera)
        if not box.any() and not unsure.any():
            continue
        own = belongs // data.per_cell == number
        columns = {name: column[own] for name, column in splats.items()}
        factors = (weighted.opacity_divisor, weighted.background)
        made.append(_Cell(float(found.depth[number]), box, unsure, factors, **columns))
    return made


def _splats(
    one: SplatSet, camera: Camera, first: int, visibility: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the Gaussians of a set that are drawn where their cells are."""
    data = one.data
    rows = data.rows[: data.count].astype(np.float64)
    found, far = ellipses(rows, one, camera), one.depth_range
    with np.errstate(all="ignore"):
        opacity = (
            rows[:, 3]
            * one.opacity_scale
            * np.repeat(visibility, data.per_cell)[: len(rows)]
        )
        if far is not None:
            opacity = opacity * (1 - found.depth / far)
        opacity = np.minimum(opacity, 1)
        if one.antialias == "mip":
            ratio = np.linalg.det(found.bare) / np.linalg.det(found.wide)
            opacity = opacity * np.sqrt(np.maximum(ratio, 0))
        color = colors(one, camera)
        low, high = (-np.inf, np.inf) if one.clip is None else (one.clip.low, one.clip.high)
        kept = found.sound & (found.depth > camera.near) & (opacity >= _CULL)
        kept &= ((rows[:, :3] >= low) & (rows[:, :3] <= high)).all(axis=1)
        kept &= np.isfinite(color).all(axis=1)
    radius, ring = _reach(found.wide[kept], 3)
    return {
        "mean": found.mean[kept],
        "conic": np.linalg.inv(found.wide[kept]),
        "opacity": opacity[kept],
        "radius": radius,
        "ring": ring,
        "away": found.depth[kept],
        "color": np.maximum(color[kept], 0),
        "normal": normals(found, kept, camera),
        "place": first + np.flatnonzero(kept),
    }


def _reach(wide: np.ndarray, deviations: float) -> tuple[np.ndarray, np.ndarray]:
    """Return radii of whole pixels, and within how many pixels of each float32 may err."""
    middle = (wide[:, 0, 0] + wide[:, 1, 1]) / 2
    longest = middle + np.sqrt(np.maximum(0.1, middle**2 - np.linalg.det(wide)))
    bare = deviations * np.sqrt(longest)
    unsure = np.abs(bare - np.round(bare)) <= 1e-5 * bare + 1e-5
    return np.ceil(bare), np.where(unsure, 1.1, _PIXELS)


def _box(
    mean: np.ndarray, wide: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels of a cell's tiles, and those that float32 may add or leave out."""
    (radius,), (ring,) = _reach(wide[None], 2)
    every = [
        _tiles(mean + shift * np.array(way), radius, camera)
        for shift in ([-_PIXELS, _PIXELS] if ring < 1 else [-_PIXELS, _PIXELS, -1.1, 1.1])
        for way in ((1, 1), (1, -1))
    ]
    box = _tiles(mean, radius, camera)
    return box, np.any([one != box for one in every], axis=0)


def _tiles(mean: np.ndarray, radius: float, camera: Camera) -> np.ndarray:
    """Return which pixels are in tiles from the circle's left to 15 pixels past its right end."""
    inside = []
    for axis, side in enumerate((camera.width, camera.height)):
        tile = np.arange(side) // _TILE
        extent, turns = radius, [0.0]
        if camera.kind == "panorama" and axis == 0:
            turn = 2 * np.pi * camera.fx
            extent, turns = min(radius, turn / 2), [-turn, 0.0, turn]
        along = np.zeros(side, bool)
        for shift in turns:
            middle = mean[axis] + shift - 0.5
            begin = np.floor((middle - extent) / _TILE)
            end = np.floor((middle + extent + _TILE - 1) / _TILE)
            along |= (tile >= begin) & (tile < end)
        inside.append(along)
    return np.asarray(inside[1][:, None] & inside[0])

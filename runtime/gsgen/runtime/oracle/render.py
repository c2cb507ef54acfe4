"""Reference renderer in float64 NumPy, which shares no code with the kernels.

It follows the specification's page on conventions, section "Drawing", one Gaussian after the
other, and is slow. Two details that the page leaves open are those of the reference rasterisers
(gsplat, Kerbl et al. 2023): the Jacobian of a centre far outside the image is that of a centre 0.3
half images outside, and a pixel is finished before the first Gaussian that would leave less than
1e-4 of the light. A panorama follows the guide "Coordinate systems and cameras".
"""

__all__ = ["Picture", "render"]

from collections.abc import Sequence
from typing import Final

import numpy as np

from gsgen.runtime.oracle import projection
from gsgen.runtime.oracle.meshes import Surface, cast
from gsgen.runtime.oracle.projection import BAND, CULL, MOST_ALPHA, TIE, Picture, Splats
from gsgen.runtime.oracle.weighted_sums import Veil, alone, sums
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

_FINISHED: Final = 1e-4
_TOUCH_TOLERANCE: Final = 1e-4  # relative difference of depths at which a Gaussian touches a mesh
_SEAM_PIXELS: Final = 2e-3  # pixels from half a turn, where rounding may choose the other copy


def render(
    scene: Scene,
    camera: Camera,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    published: bool = False,
) -> Picture:
    """Draw a scene with the float64 reference renderer.

    Args:
        scene: The scene.
        camera: The camera, with the image size.
        background: Red, green, blue and alpha of the background.
        published: Whether weighted sums count backgrounds as the method's own renderer does.
    """
    # Step 1: draw what is no depth-sorted splat: meshes, and the layer of weighted sums before them.
    walls = cast(scene.meshes, camera, scene.color_space)
    veil = sums(scene, camera, walls.depth)
    if not scene.meshes and scene.sets and all(splat_set.weighted for splat_set in scene.sets):
        return alone(veil, background, published=published)
    # Step 2: project all depth-sorted sets, and sort their splats together.
    no_rows = SplatData(np.zeros((0, 10), np.float32), np.zeros((0, 3), np.float32), "rgb")
    first, parts = 0, [projection.drawn_splats(SplatSet(no_rows), camera, 0)]
    for splat_set in scene.sets:
        if splat_set.weighted is None:
            parts.append(projection.drawn_splats(splat_set, camera, first))
        first += len(splat_set.data)
    names = Splats.__slots__
    joined = Splats(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )
    # A stable sort: splats of one depth stay in the order of the sets.
    splats = joined.take(np.argsort(joined.depth, kind="stable"))
    return _blend(splats, camera, background, walls, veil.veil())


def _blend(
    splats: Splats, camera: Camera, background: Sequence[float], walls: Surface, veil: Veil
) -> Picture:
    height, width = camera.height, camera.width
    color, normal = np.zeros((height, width, 3)), np.zeros((height, width, 3))
    through, depth = np.ones((height, width)), np.zeros((height, width))
    median = np.full((height, width), np.inf)
    ids, finished = np.full((height, width), -1), np.zeros((height, width), bool)
    fragile, fragile_median = walls.fragile | veil.fragile, finished.copy()
    waiting = np.isfinite(veil.depth)
    close = _ties(splats.depth)
    nearer_hit, nearer_window = finished.copy(), (slice(0), slice(0))
    visible = 0
    inverses, windows = np.linalg.inv(splats.covariance), _pixel_windows(splats, camera)
    for i, (left, top, right, bottom) in enumerate(windows):
        window = slice(top, bottom), slice(left, right)
        if left >= right or top >= bottom:
            nearer_hit[nearer_window] = False
            continue
        # Step 1: the splat's opacity at the pixels that it may reach.
        unclamped, dx = _opacity(splats, i, inverses[i], window, camera)
        alpha = np.minimum(unclamped, MOST_ALPHA)
        # Step 2: where the layer of weighted sums is nearer, it takes its light first.
        if waiting[window].any():
            covered = np.zeros_like(waiting)
            covered[window] = (waiting[window]) & (splats.depth[i] > veil.depth[window])
            _blend_layer(covered, veil, color, normal, depth, through, median, fragile_median)
            waiting &= ~covered
        # Step 3: the splat is drawn where it is opaque enough, before walls, and leaves enough light.
        before = through[window].copy()
        in_front = splats.depth[i] <= walls.depth[window]
        hit = (alpha >= CULL) & ~finished[window] & in_front
        visible += bool((alpha >= CULL).any())
        after = before * (1 - alpha)
        stop = hit & (after <= _FINISHED)
        # Step 4: mark pixels where the last bits of float32 may decide otherwise.
        near_edge = _is_near_edge(unclamped, dx, camera)
        near_wall = _is_touching(splats.depth[i], walls.depth[window])
        near_wall |= _is_touching(splats.depth[i], veil.depth[window])
        fragile[window] |= ~finished[window] & (alpha >= CULL) & near_wall
        near_stop = hit & (np.abs(after / _FINISHED - 1) <= BAND)
        fragile[window] |= ~finished[window] & (near_edge | near_stop)
        if close[i]:
            fragile[window] |= hit & nearer_hit[window]
        nearer_hit[nearer_window] = False
        nearer_hit[window], nearer_window = hit, window
        # Step 5: add the share of the light that the splat takes, and keep the rest.
        finished[window] |= stop
        drawn = hit & ~stop
        amount = np.where(drawn, alpha * before, 0)
        color[window] += amount[..., None] * splats.color[i]
        normal[window] += amount[..., None] * splats.normal[i]
        depth[window] += amount * splats.depth[i]
        # Step 6: the median depth is where half of the light is gone.
        halved = hit & (before >= 0.5) & (after < 0.5)
        median[window] = np.where(halved, splats.depth[i], median[window])
        ids[window] = np.where(halved, splats.index[i], ids[window])
        fragile_median[window] |= hit & (np.abs(after - 0.5) <= BAND)
        through[window] = np.where(drawn, after, before)
    # Step 7: behind all splats come the layer, and the meshes, which take the remaining light.
    _blend_layer(waiting, veil, color, normal, depth, through, median, fragile_median)
    wall = np.isfinite(walls.depth)
    remaining = np.where(wall, through, 0)
    color += remaining[..., None] * walls.color
    normal += remaining[..., None] * walls.normal
    depth += remaining * np.where(wall, walls.depth, 0)
    median = np.where(wall & (through >= 0.5), walls.depth, median)
    through = through - remaining
    covered = through < 1
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    return Picture(
        rgba=_over(background, color, through),
        depth=np.where(covered, depth / np.where(covered, 1 - through, 1), np.inf),
        median_depth=median,
        ids=ids,
        normal=normal / np.where(size > 0, size, 1),
        fragile=fragile,
        fragile_median=fragile_median | fragile,
        visible=visible,
    )


def _opacity(
    splats: Splats, i: int, inverse: np.ndarray, window: tuple[slice, slice], camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return a Gaussian's opacities at the pixels of a window, and their horizontal offsets."""
    rows, columns = window
    dx = projection.across(np.arange(columns.start, columns.stop) + 0.5, splats.mean[i, 0], camera)
    dy = np.arange(rows.start, rows.stop)[:, None] + 0.5 - splats.mean[i, 1]
    (a, b), (_, c) = inverse
    return splats.opacity[i] * np.exp(-0.5 * (a * dx**2 + c * dy**2) - b * dx * dy), dx


def _over(background: Sequence[float], color: np.ndarray, through: np.ndarray) -> np.ndarray:
    """Composite colours over the background, and append alpha."""
    red, green, blue, opaque = background
    mixed = color + through[..., None] * np.array([red, green, blue]) * opaque
    alpha = 1 - through + through * opaque
    return np.concatenate([mixed, alpha[..., None]], axis=-1)


def _is_near_edge(unclamped: np.ndarray, dx: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the pixels at which rounding decides whether a Gaussian is drawn."""
    near_edge = np.abs(unclamped / CULL - 1) <= BAND
    if camera.kind == "panorama":
        behind = np.abs(np.abs(dx) - np.pi * camera.fx) <= _SEAM_PIXELS
        near_edge |= behind & (np.minimum(unclamped, MOST_ALPHA) >= CULL * (1 - BAND))
    return np.asarray(near_edge)


def _is_touching(depth: float, surface: np.ndarray) -> np.ndarray:
    """Return the pixels at which a mesh surface has the depth of a Gaussian, up to rounding."""
    return np.asarray(np.abs(depth - surface) <= _TOUCH_TOLERANCE * depth)


def _blend_layer(
    pixels: np.ndarray,
    veil: Veil,
    color: np.ndarray,
    normal: np.ndarray,
    depth: np.ndarray,
    through: np.ndarray,
    median: np.ndarray,
    fragile_median: np.ndarray,
) -> None:
    """Blend the image layer of weighted-sum rendering into selected pixels, in place."""
    remaining = through[pixels]
    color[pixels] += remaining[:, None] * veil.color[pixels]
    normal[pixels] += remaining[:, None] * veil.normal[pixels]
    depth[pixels] += remaining * veil.alpha[pixels] * veil.depth[pixels]
    through[pixels] = remaining * (1 - veil.alpha[pixels])
    halved = (remaining >= 0.5) & (through[pixels] < 0.5)
    median[pixels] = np.where(halved, veil.depth[pixels], median[pixels])
    fragile_median[pixels] |= np.abs(through[pixels] - 0.5) <= BAND


def _ties(depth: np.ndarray) -> np.ndarray:
    """Return the mask of sorted depths so near the previous depth that rounding may swap both."""
    gap = np.diff(depth, prepend=-np.inf)
    return np.asarray((gap > 0) & (gap < TIE * np.abs(depth)))


def _pixel_windows(splats: Splats, camera: Camera) -> list[list[int]]:
    """Return the pixels that each Gaussian may reach: left, top, right, bottom."""
    diagonals = np.diagonal(splats.covariance, axis1=1, axis2=2)
    spread = 2 * np.log(splats.opacity / CULL)[:, None] * diagonals
    reach = np.sqrt(np.maximum(spread, 0)) + 0.01
    limits = np.array([camera.width, camera.height])
    low = np.clip(np.floor(splats.mean - reach - 0.5), 0, limits).astype(int)
    high = np.clip(np.ceil(splats.mean + reach + 0.5), 0, limits).astype(int)
    if camera.kind == "panorama":  # a Gaussian may cross the seam
        low[:, 0], high[:, 0] = 0, camera.width
    windows: list[list[int]] = np.concatenate([low, high], axis=1).tolist()
    return windows

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
from gsgen.runtime.oracle.meshes import Surface, cast_rays
from gsgen.runtime.oracle.projection import (
    FRAGILE_BAND,
    MAX_ALPHA,
    MIN_ALPHA,
    TIE_TOLERANCE,
    Picture,
    Splats,
)
from gsgen.runtime.oracle.weighted_sums import ImageLayer, render_alone, sums
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

_MIN_TRANSMITTANCE: Final = 1e-4
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
    surfaces = cast_rays(scene.meshes, camera, scene.color_space)
    layer = sums(scene, camera, surfaces.depth)
    if not scene.meshes and scene.sets and all(splat_set.weighted for splat_set in scene.sets):
        return render_alone(layer, background, published=published)
    # Step 2: project all depth-sorted sets, and sort their splats together.
    no_rows = SplatData(np.zeros((0, 10), np.float32), np.zeros((0, 3), np.float32), "rgb")
    first, splat_parts = 0, [projection.drawn_splats(SplatSet(no_rows), camera, 0)]
    for splat_set in scene.sets:
        if splat_set.weighted is None:
            splat_parts.append(projection.drawn_splats(splat_set, camera, first))
        first += len(splat_set.data)
    names = Splats.__slots__
    joined_splats = Splats(
        **{name: np.concatenate([getattr(part, name) for part in splat_parts]) for name in names}
    )
    # A stable sort: splats of one depth stay in the order of the sets.
    splats = joined_splats.take(np.argsort(joined_splats.depth, kind="stable"))
    return _blend(splats, camera, background, surfaces, layer.image_layer())


def _blend(
    splats: Splats,
    camera: Camera,
    background: Sequence[float],
    surfaces: Surface,
    layer: ImageLayer,
) -> Picture:
    height, width = camera.height, camera.width
    color, normal = np.zeros((height, width, 3)), np.zeros((height, width, 3))
    transmittance, depth = np.ones((height, width)), np.zeros((height, width))
    median = np.full((height, width), np.inf)
    ids, is_finished = np.full((height, width), -1), np.zeros((height, width), bool)
    fragile, fragile_median = surfaces.fragile | layer.fragile, is_finished.copy()
    is_pending = np.isfinite(layer.depth)
    is_tied = _mark_tied_depths(splats.depth)
    previous_hit, previous_window = is_finished.copy(), (slice(0), slice(0))
    visible = 0
    inverses, pixel_windows = np.linalg.inv(splats.covariance), _pixel_windows(splats, camera)
    for i, (left, top, right, bottom) in enumerate(pixel_windows):
        window = slice(top, bottom), slice(left, right)
        if left >= right or top >= bottom:
            previous_hit[previous_window] = False
            continue
        # Step 1: the splat's opacity at the pixels that it may reach.
        unclamped_alpha, dx = _pixel_opacity(splats, i, inverses[i], window, camera)
        alpha = np.minimum(unclamped_alpha, MAX_ALPHA)
        # Step 2: where the layer of weighted sums is nearer, it takes its light first.
        if is_pending[window].any():
            is_covered = np.zeros_like(is_pending)
            is_covered[window] = (is_pending[window]) & (splats.depth[i] > layer.depth[window])
            _blend_layer(
                is_covered, layer, color, normal, depth, transmittance, median, fragile_median
            )
            is_pending &= ~is_covered
        # Step 3: the splat is drawn where it is opaque enough, before walls, and leaves enough light.
        light_before = transmittance[window].copy()
        is_in_front = splats.depth[i] <= surfaces.depth[window]
        is_hit = (alpha >= MIN_ALPHA) & ~is_finished[window] & is_in_front
        visible += bool((alpha >= MIN_ALPHA).any())
        light_after = light_before * (1 - alpha)
        is_stopped = is_hit & (light_after <= _MIN_TRANSMITTANCE)
        # Step 4: mark pixels where the last bits of float32 may decide otherwise.
        is_near_edge = _is_near_edge(unclamped_alpha, dx, camera)
        is_near_surface = _is_touching_surface(splats.depth[i], surfaces.depth[window])
        is_near_surface |= _is_touching_surface(splats.depth[i], layer.depth[window])
        fragile[window] |= ~is_finished[window] & (alpha >= MIN_ALPHA) & is_near_surface
        is_near_stop = is_hit & (np.abs(light_after / _MIN_TRANSMITTANCE - 1) <= FRAGILE_BAND)
        fragile[window] |= ~is_finished[window] & (is_near_edge | is_near_stop)
        if is_tied[i]:
            fragile[window] |= is_hit & previous_hit[window]
        previous_hit[previous_window] = False
        previous_hit[window], previous_window = is_hit, window
        # Step 5: add the share of the light that the splat takes, and keep the rest.
        is_finished[window] |= is_stopped
        is_drawn = is_hit & ~is_stopped
        contribution = np.where(is_drawn, alpha * light_before, 0)
        color[window] += contribution[..., None] * splats.color[i]
        normal[window] += contribution[..., None] * splats.normal[i]
        depth[window] += contribution * splats.depth[i]
        # Step 6: the median depth is where half of the light is gone.
        is_median_crossing = is_hit & (light_before >= 0.5) & (light_after < 0.5)
        median[window] = np.where(is_median_crossing, splats.depth[i], median[window])
        ids[window] = np.where(is_median_crossing, splats.index[i], ids[window])
        fragile_median[window] |= is_hit & (np.abs(light_after - 0.5) <= FRAGILE_BAND)
        transmittance[window] = np.where(is_drawn, light_after, light_before)
    # Step 7: behind all splats come the layer, and the meshes, which take the remaining light.
    _blend_layer(is_pending, layer, color, normal, depth, transmittance, median, fragile_median)
    is_surface = np.isfinite(surfaces.depth)
    remaining_transmittance = np.where(is_surface, transmittance, 0)
    color += remaining_transmittance[..., None] * surfaces.color
    normal += remaining_transmittance[..., None] * surfaces.normal
    depth += remaining_transmittance * np.where(is_surface, surfaces.depth, 0)
    median = np.where(is_surface & (transmittance >= 0.5), surfaces.depth, median)
    transmittance = transmittance - remaining_transmittance
    is_covered = transmittance < 1
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    return Picture(
        rgba=_composite_over(background, color, transmittance),
        depth=np.where(is_covered, depth / np.where(is_covered, 1 - transmittance, 1), np.inf),
        median_depth=median,
        ids=ids,
        normal=normal / np.where(size > 0, size, 1),
        fragile=fragile,
        fragile_median=fragile_median | fragile,
        visible=visible,
    )


def _pixel_opacity(
    splats: Splats, i: int, inverse: np.ndarray, window: tuple[slice, slice], camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return a Gaussian's opacities at the pixels of a window, and their horizontal offsets."""
    rows, columns = window
    dx = projection.pixel_offset(
        np.arange(columns.start, columns.stop) + 0.5, splats.mean[i, 0], camera
    )
    dy = np.arange(rows.start, rows.stop)[:, None] + 0.5 - splats.mean[i, 1]
    (a, b), (_, c) = inverse
    return splats.opacity[i] * np.exp(-0.5 * (a * dx**2 + c * dy**2) - b * dx * dy), dx


def _composite_over(
    background: Sequence[float], color: np.ndarray, transmittance: np.ndarray
) -> np.ndarray:
    """Composite colours over the background, and append alpha."""
    red, green, blue, background_alpha = background
    mixed_color = color + transmittance[..., None] * np.array([red, green, blue]) * background_alpha
    alpha = 1 - transmittance + transmittance * background_alpha
    return np.concatenate([mixed_color, alpha[..., None]], axis=-1)


def _is_near_edge(unclamped_alpha: np.ndarray, dx: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the pixels at which rounding decides whether a Gaussian is drawn."""
    is_near_edge = np.abs(unclamped_alpha / MIN_ALPHA - 1) <= FRAGILE_BAND
    if camera.kind == "panorama":
        is_near_seam = np.abs(np.abs(dx) - np.pi * camera.fx) <= _SEAM_PIXELS
        is_near_edge |= is_near_seam & (
            np.minimum(unclamped_alpha, MAX_ALPHA) >= MIN_ALPHA * (1 - FRAGILE_BAND)
        )
    return np.asarray(is_near_edge)


def _is_touching_surface(depth: float, surface: np.ndarray) -> np.ndarray:
    """Return the pixels at which a mesh surface has the depth of a Gaussian, up to rounding."""
    return np.asarray(np.abs(depth - surface) <= _TOUCH_TOLERANCE * depth)


def _blend_layer(
    pixels: np.ndarray,
    layer: ImageLayer,
    color: np.ndarray,
    normal: np.ndarray,
    depth: np.ndarray,
    transmittance: np.ndarray,
    median: np.ndarray,
    fragile_median: np.ndarray,
) -> None:
    """Blend the image layer of weighted-sum rendering into selected pixels, in place."""
    remaining_transmittance = transmittance[pixels]
    color[pixels] += remaining_transmittance[:, None] * layer.color[pixels]
    normal[pixels] += remaining_transmittance[:, None] * layer.normal[pixels]
    depth[pixels] += remaining_transmittance * layer.alpha[pixels] * layer.depth[pixels]
    transmittance[pixels] = remaining_transmittance * (1 - layer.alpha[pixels])
    is_median_crossing = (remaining_transmittance >= 0.5) & (transmittance[pixels] < 0.5)
    median[pixels] = np.where(is_median_crossing, layer.depth[pixels], median[pixels])
    fragile_median[pixels] |= np.abs(transmittance[pixels] - 0.5) <= FRAGILE_BAND


def _mark_tied_depths(depth: np.ndarray) -> np.ndarray:
    """Return the mask of sorted depths so near the previous depth that rounding may swap both."""
    depth_gap = np.diff(depth, prepend=-np.inf)
    return np.asarray((depth_gap > 0) & (depth_gap < TIE_TOLERANCE * np.abs(depth)))


def _pixel_windows(splats: Splats, camera: Camera) -> list[list[int]]:
    """Return the pixels that each Gaussian may reach: left, top, right, bottom."""
    diagonals = np.diagonal(splats.covariance, axis1=1, axis2=2)
    squared_extent = 2 * np.log(splats.opacity / MIN_ALPHA)[:, None] * diagonals
    half_size = np.sqrt(np.maximum(squared_extent, 0)) + 0.01
    limits = np.array([camera.width, camera.height])
    low = np.clip(np.floor(splats.mean - half_size - 0.5), 0, limits).astype(int)
    high = np.clip(np.ceil(splats.mean + half_size + 0.5), 0, limits).astype(int)
    if camera.kind == "panorama":  # a Gaussian may cross the seam
        low[:, 0], high[:, 0] = 0, camera.width
    pixel_windows: list[list[int]] = np.concatenate([low, high], axis=1).tolist()
    return pixel_windows

"""Reference of weighted-sum rendering: blends cells (groups of Gaussians) in float64 NumPy.

It follows the specification's page on cells. Cells end at whole tiles and Gaussians at circles of
whole pixels, as in the renderer of Liu et al. 2025.
"""

__all__ = ["ImageLayer", "WeightedSums", "render_alone", "sums"]

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float, Int64

from gsgen.runtime.oracle import projection
from gsgen.runtime.oracle.projection import (
    FRAGILE_BAND,
    MAX_ALPHA,
    MIN_ALPHA,
    TIE_TOLERANCE,
    Picture,
    Splats,
)
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet

_MIN_TRANSMITTANCE: Final = 0.01
_TILE_PIXELS: Final = 16

_EDGE_TOLERANCE_PIXELS: Final = (
    2e-3  # distance from a circle's edge within which float32 may decide otherwise
)
_EQUALITY_TOLERANCE: Final = 1e-4  # relative difference of depths or opacities that counts as equal


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WeightedSums:
    """The sums of weighted-sum rendering at each pixel: Σ w of colour, normal and depth.

    Attributes:
        color: Σ w c.
        normal: Σ w n, in world space.
        depth: Σ w z.
        total: Σ w.
        depth_behind: Σ w b, where b is the set's weight of the background.
        transmittance: The light that passes.
        median_depth: Depth of the Gaussian that covers most in the cell where half of the light
            is gone.
        ids: Index of that Gaussian in the scene; −1 for none.
        fragile: Pixels where float32 may decide otherwise.
        fragile_median: The same for the median depth and the ids.
        visible: Number of Gaussians that reach a pixel's centre in a tile of their cell.
    """

    color: Float[np.ndarray, "h w 3"]
    normal: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    total: Float[np.ndarray, "h w"]
    depth_behind: Float[np.ndarray, "h w"]
    transmittance: Float[np.ndarray, "h w"]
    median_depth: Float[np.ndarray, "h w"]
    ids: Int64[np.ndarray, "h w"]
    fragile: Bool[np.ndarray, "h w"]
    fragile_median: Bool[np.ndarray, "h w"]
    visible: int

    @property
    def weight_behind(self) -> Float[np.ndarray, "h w"]:
        """The weight of the background: 1 at pixels without Gaussians, 0 at opaque pixels."""
        mean = np.divide(
            self.depth_behind, self.total, out=np.ones_like(self.total), where=self.total > 0
        )
        return np.asarray(np.where(self.transmittance < _MIN_TRANSMITTANCE, 0, mean))

    @property
    def scale(self) -> Float[np.ndarray, "h w"]:
        """The divisor of weighted sums: all weights at a pixel, and that of the background."""
        return np.asarray(self.total + self.weight_behind * self.transmittance)

    def image_layer(self) -> "ImageLayer":
        """Return weighted sums as a translucent image layer, to composite with other splat sets."""
        is_covered = self.total > 0
        return ImageLayer(
            color=self.color / self.scale[..., None],
            alpha=self.total / self.scale,
            normal=self.normal / self.scale[..., None],
            depth=np.where(is_covered, self.depth / np.where(is_covered, self.total, 1), np.inf),
            fragile=self.fragile,
        )


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImageLayer:
    """A translucent image layer: a colour, an alpha, a normal and a depth at each pixel.

    Attributes:
        color: Colours multiplied by alpha.
        alpha: Covered share of the background.
        normal: Normals in world space, multiplied by alpha.
        depth: Mean depth; infinite where nothing is drawn.
        fragile: Pixels where float32 may decide otherwise.
    """

    color: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    fragile: Bool[np.ndarray, "h w"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Cell:
    """A visible cell (a group of Gaussians that are sorted as one), with its Gaussians.

    Attributes:
        depth: Depth of the cell's centre.
        pixel_box: Pixels of the cell's tiles.
        is_uncertain: Pixels of tiles that float32 may add or leave out.
        factors: Divisor of the opacity, and weight of the background.
        splats: The drawn Gaussians.
        radius: Radius of each Gaussian's circle, in whole pixels.
        ring_radius: Distance from the circle within which float32 may decide otherwise, in pixels.
    """

    depth: float
    pixel_box: np.ndarray
    is_uncertain: np.ndarray
    factors: tuple[float, float]
    splats: Splats
    radius: np.ndarray
    ring_radius: np.ndarray


def render_alone(
    cell_sums: WeightedSums, background: Sequence[float], *, published: bool = False
) -> Picture:
    """Return the picture of weighted-sum rendering over a background."""
    image_layer, background_weight = (
        cell_sums.image_layer(),
        cell_sums.weight_behind / cell_sums.scale,
    )
    cell_weight = background_weight if published else background_weight * cell_sums.transmittance
    *color, background_alpha = background
    image = image_layer.color + cell_weight[..., None] * np.array(color) * background_alpha
    size = np.linalg.norm(image_layer.normal, axis=-1, keepdims=True)
    return Picture(
        rgba=np.concatenate(
            [image, (image_layer.alpha + (1 - image_layer.alpha) * background_alpha)[..., None]],
            axis=-1,
        ),
        depth=image_layer.depth,
        median_depth=cell_sums.median_depth,
        ids=cell_sums.ids,
        normal=image_layer.normal / np.where(size > 0, size, 1),
        fragile=cell_sums.fragile,
        fragile_median=cell_sums.fragile_median | cell_sums.fragile,
        visible=cell_sums.visible,
    )


def sums(
    scene: Scene, camera: Camera, walls: Float[np.ndarray, "h w"] | None = None
) -> WeightedSums:
    """Sum the Gaussians of a scene's weighted splat sets that are in front of the meshes."""
    shape = (camera.height, camera.width)
    limit = np.full(shape, np.inf) if walls is None else walls
    # Step 1: find the cells of all sets, and sort them by depth.
    first, cells = 0, []
    for splat_set in scene.sets:
        if splat_set.weighted is not None:
            cells += _cells(splat_set, camera, first)
        first += len(splat_set.data)
    cells.sort(key=lambda cell: cell.depth)  # stable
    # Step 2: add the cells, nearest first; cells of nearly one depth may change places in float32.
    state = _BlendState(shape)
    before: _Cell | None = None
    touched_pixels = np.zeros(shape, bool)
    for cell in cells:
        depth_gap = np.inf if before is None else cell.depth - before.depth
        is_tied = (
            touched_pixels if 0 < depth_gap < TIE_TOLERANCE * cell.depth else np.zeros(shape, bool)
        )
        touched_pixels = state.add_cell(cell, camera, limit, is_tied)
        before = cell
    end = np.abs(state.transmittance / _MIN_TRANSMITTANCE - 1) <= FRAGILE_BAND
    return WeightedSums(
        color=state.color,
        normal=state.normal,
        depth=state.depth,
        total=state.total,
        depth_behind=state.depth_behind,
        transmittance=state.transmittance,
        median_depth=state.median,
        ids=state.ids,
        fragile=state.fragile | end,
        fragile_median=state.fragile_median,
        visible=state.visible,
    )


class _BlendState:
    """Each pixel's weighted sums and transmittance after the groups of Gaussians added so far."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.color, self.normal = np.zeros((*shape, 3)), np.zeros((*shape, 3))
        self.depth, self.total, self.depth_behind = (np.zeros(shape) for _ in range(3))
        self.transmittance, self.visible = np.ones(shape), 0
        self.median, self.ids = np.full(shape, np.inf), np.full(shape, -1)
        self.fragile, self.fragile_median = np.zeros(shape, bool), np.zeros(shape, bool)

    def add_cell(
        self, cell: _Cell, camera: Camera, limit: np.ndarray, is_tied: np.ndarray
    ) -> np.ndarray:
        """Add the weighted sums of the next cell (group of Gaussians); return touched pixels."""
        (divisor, depth_behind), splats = cell.factors, cell.splats
        # Step 1: all Gaussians of the cell are weighted by the light before it; finished pixels take none.
        entered_transmittance = self.transmittance.copy()
        entered_pixels = cell.pixel_box & (entered_transmittance >= _MIN_TRANSMITTANCE)
        changed, most = np.zeros_like(entered_pixels), np.zeros(entered_pixels.shape)
        second_opacity, strongest_index = (
            np.zeros(entered_pixels.shape),
            np.full(entered_pixels.shape, -1),
        )
        x, y = np.arange(camera.width) + 0.5, np.arange(camera.height)[:, None] + 0.5
        for k, depth in enumerate(splats.depth):
            # Step 2: a Gaussian counts within its circle, where it is opaque enough, and before meshes.
            dx = projection.pixel_offset(x, splats.mean[k, 0], camera)
            dy = y - splats.mean[k, 1]
            (a, b), (_, c) = np.linalg.inv(splats.covariance[k])
            unclamped_opacity = splats.opacity[k] * np.exp(
                -0.5 * (a * dx**2 + c * dy**2) - b * dx * dy
            )
            pixel_distance = np.hypot(dx, dy)
            is_inside = (unclamped_opacity >= MIN_ALPHA) & (pixel_distance <= cell.radius[k])
            is_hit_pixel = is_inside & entered_pixels & (depth <= limit)
            # Step 3: mark pixels where the last bits of float32 may decide otherwise.
            is_near_threshold = np.abs(unclamped_opacity / MIN_ALPHA - 1) <= FRAGILE_BAND
            is_near_threshold |= np.abs(pixel_distance - cell.radius[k]) <= cell.ring_radius[k]
            is_near_threshold |= np.abs(depth - limit) <= _EQUALITY_TOLERANCE * depth
            is_reached = unclamped_opacity >= MIN_ALPHA * (1 - FRAGILE_BAND)
            touched_pixels_mask = cell.pixel_box | cell.is_uncertain
            self.fragile |= (
                is_reached
                & is_near_threshold
                & touched_pixels_mask
                & (entered_transmittance >= _MIN_TRANSMITTANCE * (1 - FRAGILE_BAND))
            )
            self.fragile |= is_inside & cell.is_uncertain
            # Step 4: add its weighted values, and take its share of the light.
            alpha = np.where(is_hit_pixel, np.minimum(unclamped_opacity, MAX_ALPHA) / divisor, 0)
            self.transmittance *= np.maximum(1 - alpha, 0)
            contribution = alpha * entered_transmittance
            self.color += contribution[..., None] * splats.color[k]
            self.normal += contribution[..., None] * splats.normal[k]
            self.depth += contribution * depth
            self.total += contribution
            self.depth_behind += contribution * depth_behind
            changed |= is_inside & cell.pixel_box
            self.visible += bool((is_inside & cell.pixel_box).any())
            # Step 5: remember the most opaque Gaussian: at the median depth, it stands for the cell.
            is_larger = alpha > most
            second_opacity = np.where(is_larger, most, np.maximum(second_opacity, alpha))
            most = np.where(is_larger, alpha, most)
            strongest_index = np.where(is_larger, k, strongest_index)
        # Step 6: the median depth is in the cell where half of the light is gone.
        is_near_termination = np.abs(entered_transmittance / _MIN_TRANSMITTANCE - 1) <= FRAGILE_BAND
        self.fragile |= changed & (is_near_termination | is_tied)
        is_median_crossing = (entered_transmittance >= 0.5) & (self.transmittance < 0.5)
        self.median[is_median_crossing] = splats.depth[strongest_index[is_median_crossing]]
        self.ids[is_median_crossing] = splats.index[strongest_index[is_median_crossing]]
        is_near_half = np.abs(self.transmittance - 0.5) <= FRAGILE_BAND
        is_uncertain_median = is_median_crossing & (
            second_opacity >= most * (1 - _EQUALITY_TOLERANCE)
        )
        self.fragile_median |= changed & (is_near_half | is_uncertain_median)
        return changed


def _cells(splat_set: SplatSet, camera: Camera, first: int) -> list[_Cell]:
    """Return the cells (groups of Gaussians) of a splat set that touch image tiles."""
    data, weighted = splat_set.data, splat_set.weighted
    assert data.cells is not None
    assert weighted is not None
    live_cells = -(-data.count // data.per_cell)
    rows = data.cells[:live_cells].astype(np.float64)
    shapes = projection.ellipses(rows, splat_set, camera)
    is_drawn = shapes.is_finite & (shapes.depth > camera.near) & (rows[:, 3] > 0)
    visibility = np.repeat(rows[:, 3], data.per_cell)[: data.count]
    splats = projection.drawn_splats(splat_set, camera, first, visibility)
    cells = []
    for number in np.flatnonzero(is_drawn):
        pixel_box, is_uncertain = _cell_pixels(
            shapes.mean[number], shapes.dilated_covariance[number], camera
        )
        if not pixel_box.any() and not is_uncertain.any():
            continue
        members = splats.take((splats.index - first) // data.per_cell == number)
        radius, ring_radius = _bounding_radii(members.covariance, 3)
        cells.append(
            _Cell(
                depth=float(shapes.depth[number]),
                pixel_box=pixel_box,
                is_uncertain=is_uncertain,
                factors=(weighted.opacity_divisor, weighted.background),
                splats=members,
                radius=radius,
                ring_radius=ring_radius,
            )
        )
    return cells


def _bounding_radii(covariance: np.ndarray, sigmas: float) -> tuple[np.ndarray, np.ndarray]:
    """Return circle radii of projected Gaussians in pixels, and the radii's float32 error."""
    middle = (covariance[:, 0, 0] + covariance[:, 1, 1]) / 2
    largest_eigenvalue = middle + np.sqrt(np.maximum(0.1, middle**2 - np.linalg.det(covariance)))
    radius = sigmas * np.sqrt(largest_eigenvalue)
    is_uncertain = np.abs(radius - np.round(radius)) <= 1e-5 * radius + 1e-5
    return np.ceil(radius), np.where(is_uncertain, 1.1, _EDGE_TOLERANCE_PIXELS)


def _cell_pixels(
    mean: np.ndarray, covariance: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return masks: pixels covered by a group of Gaussians; pixels where rounding decides that."""
    (radius,), (ring_radius,) = _bounding_radii(covariance[None], 2)
    boxes = [
        _tiles(mean + offset * np.array(diagonal_direction), radius, camera)
        for offset in (
            [-_EDGE_TOLERANCE_PIXELS, _EDGE_TOLERANCE_PIXELS]
            if ring_radius < 1
            else [-_EDGE_TOLERANCE_PIXELS, _EDGE_TOLERANCE_PIXELS, -1.1, 1.1]
        )
        for diagonal_direction in ((1, 1), (1, -1))
    ]
    pixel_box = _tiles(mean, radius, camera)
    return pixel_box, np.any([candidate != pixel_box for candidate in boxes], axis=0)


def _tiles(mean: np.ndarray, radius: float, camera: Camera) -> np.ndarray:
    """Return the mask of the pixels in image tiles that a circle around ``mean`` may touch."""
    inside_boxes = []
    for axis, image_side in enumerate((camera.width, camera.height)):
        tile = np.arange(image_side) // _TILE_PIXELS
        half_extent, pixel_turns = radius, [0.0]
        if camera.kind == "panorama" and axis == 0:
            panorama_width = 2 * np.pi * camera.fx
            half_extent, pixel_turns = (
                min(radius, panorama_width / 2),
                [-panorama_width, 0.0, panorama_width],
            )
        along = np.zeros(image_side, bool)
        for offset in pixel_turns:
            middle = mean[axis] + offset - 0.5
            first_tile = np.floor((middle - half_extent) / _TILE_PIXELS)
            end = np.floor((middle + half_extent + _TILE_PIXELS - 1) / _TILE_PIXELS)
            along |= (tile >= first_tile) & (tile < end)
        inside_boxes.append(along)
    return np.asarray(inside_boxes[1][:, None] & inside_boxes[0])

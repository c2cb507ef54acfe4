"""Each kernel of weighted sums does what its NumPy twin does."""

from dataclasses import dataclass

import numpy as np
import pytest

from gsgen.runtime.kernels.project import project
from gsgen.runtime.kernels.project.project import SPLAT_RADIUS_SIGMAS
from gsgen.runtime.kernels.project.project_cells import CELL_RADIUS_SIGMAS
from gsgen.runtime.kernels.project.projections import projection_of
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from references.projection import (
    Projected,
    box_reference,
    circle_reference,
    depth_reference,
    project_reference,
)
from references.tiles import blend_wsr_reference
from support.rendering.near_ties import DEPTH_LEFT, decoded
from support.rendering.weighted_scenes import WEIGHTED

NOTHING_BEHIND = np.zeros(3)
ONE_SET = ["many_cells", "divided_opacity", "not_finite_cells", "far_beside", "invisible_cells"]


@dataclass(frozen=True)
class Run:
    """A plan that has run some stages, and what its buffers hold."""

    renderer: Renderer
    plan: Plan
    splat_set: SplatSet
    seen_by: Camera

    def words(self, name: str, count: int) -> np.ndarray:
        return self.renderer.device.read(self.plan.buffers[name], np.uint32, count)

    def floats(self, name: str, count: int) -> np.ndarray:
        return self.words(name, 4 * count).view(np.float32).reshape(count, 4)

    @property
    def origin(self) -> np.ndarray:
        return project.frame_uniform(self.seen_by, NOTHING_BEHIND)["origin"]


def run(renderer: Renderer, name: str, *stages: str) -> Run:
    """Run all of a frame, so that all has a place, and then some stages of it."""
    scene, view_camera = WEIGHTED[name]()
    renderer.render(scene, view_camera)
    placed = renderer.placed(scene)
    plan = renderer.plan(placed, view_camera, frozenset(["color"]))
    plan.submit(placed, view_camera, NOTHING_BEHIND, only=stages or None)
    plan.collect()
    return Run(renderer, plan, scene.sets[0], view_camera)


def splats(result: Run) -> Projected:
    splat_set, n = result.splat_set, len(result.splat_set.data)
    page = project.page_uniform(splat_set, result.seen_by, 0, n, splat_set.data.count)
    page["per_cell"] = splat_set.data.per_cell
    page["inverse_range"] = 0 if splat_set.depth_range is None else 1 / splat_set.depth_range
    frame = project.frame_uniform(result.seen_by, NOTHING_BEHIND)
    return project_reference(splat_set.data, frame, page, projection_of(result.seen_by))


def cells(result: Run) -> Projected:
    """Cells as if they were Gaussians: opaque, where they are visible."""
    splat_set, own = result.splat_set, result.splat_set.data.cells.copy()
    with np.errstate(invalid="ignore"):
        own[:, 3] = np.where(np.isfinite(own[:, 3]), own[:, 3] > 0, np.nan)
    bare = np.zeros((len(own), 3), np.float32)
    page = project.page_uniform(splat_set, result.seen_by, 0, len(own), len(own))
    frame = project.frame_uniform(result.seen_by, NOTHING_BEHIND)
    projection = projection_of(result.seen_by)
    return project_reference(SplatData(own, bare, "rgb"), frame, page, projection)


def dilated(actual: Projected) -> np.ndarray:
    """The 2D covariances behind conics; a ball where nothing is drawn."""
    conic = np.where(actual.drawn[:, None], actual.conic, [1.0, 0.0, 1.0])
    return np.linalg.inv(conic[:, [0, 1, 1, 2]].reshape(-1, 2, 2))


def whole(radius: np.ndarray, expected: np.ndarray, covariance: np.ndarray, reach: float) -> None:
    """Radii are the same, or one apart where what is rounded up is nearly whole."""
    middle = np.trace(covariance, axis1=1, axis2=2) / 2
    apart = np.sqrt(np.maximum(0.1, middle**2 - np.linalg.det(covariance)))
    bare = reach * np.sqrt(middle + apart)
    is_certain = np.abs(bare - np.round(bare)) > 1e-4 * bare
    np.testing.assert_array_equal(radius[is_certain], expected[is_certain])
    assert np.abs(radius - expected).max() <= 1
    assert is_certain.mean() > 0.9


@pytest.mark.parametrize("name", ONE_SET)
def test_weighted_projection_agrees_with_the_reference(renderer: Renderer, name: str) -> None:
    kernel_run = run(renderer, name, "project weighted")
    expected, n = splats(kernel_run), len(kernel_run.splat_set.data)
    keys = kernel_run.words("keys of weighted", n)
    shapes, weights = (
        kernel_run.floats("weighted shapes", n),
        kernel_run.floats("weighted weights", n),
    )
    drawn = keys != NO_ID
    assert drawn.sum() > 20
    assert not (drawn & ~expected.drawn).any()
    np.testing.assert_array_equal(weights[:, 1] >= 0, drawn)  # what blending goes by
    np.testing.assert_allclose(weights[drawn, 1], expected.strength[drawn], atol=2e-5)
    np.testing.assert_allclose(weights[drawn, 2], expected.depth[drawn], rtol=1e-5)
    size = np.abs(expected.mean[drawn]).max() + 1
    np.testing.assert_allclose(shapes[drawn, :2], expected.mean[drawn], atol=2e-6 * size)
    covariance = dilated(expected)[drawn]
    circle = circle_reference(covariance, SPLAT_RADIUS_SIGMAS)
    whole(np.sqrt(weights[drawn, 3]), circle, covariance, SPLAT_RADIUS_SIGMAS)


@pytest.mark.parametrize("name", ONE_SET)
def test_projected_cells_agree_with_the_reference(renderer: Renderer, name: str) -> None:
    kernel_run = run(renderer, name, "project weighted", "project cells")
    expected, count = cells(kernel_run), len(kernel_run.splat_set.data.cells)
    keys, circles = (
        kernel_run.words("keys of cells a", count),
        kernel_run.floats("circles of cells", count),
    )
    drawn = keys != NO_ID
    assert drawn.sum() > 10
    assert not (drawn & ~expected.drawn).any()
    for i in np.flatnonzero(expected.drawn & ~drawn):  # beside the image
        radius = circle_reference(dilated(expected)[i : i + 1], CELL_RADIUS_SIGMAS)[0]
        middle = expected.mean[i] + kernel_run.origin
        assert not box_reference(middle, radius, (61, 47)).any()
    wanted_keys, wanted_lows = depth_reference(expected.depth[drawn])
    np.testing.assert_array_equal(keys[drawn], wanted_keys)
    lows = kernel_run.words("lows of cells", count)
    np.testing.assert_array_equal(lows == NO_ID, ~drawn)
    remaining = [decoded(array).astype(np.float64) for array in (lows[drawn], wanted_lows)]
    assert (np.abs(remaining[0] - remaining[1]) <= DEPTH_LEFT * expected.depth[drawn]).all()
    covariance = dilated(expected)[drawn]
    circle = circle_reference(covariance, CELL_RADIUS_SIGMAS)
    whole(circles[drawn, 2], circle, covariance, CELL_RADIUS_SIGMAS)
    for x, y, radius, tiles in circles[drawn].astype(np.float64):
        box = box_reference(np.array([x, y]) + kernel_run.origin, radius, (61, 47))
        assert box.sum() == tiles
    spans = kernel_run.words("spans of cells", 4 * count).reshape(count, 4)[drawn]
    per_cell = kernel_run.splat_set.data.per_cell
    np.testing.assert_array_equal(spans[:, 0], per_cell * np.flatnonzero(drawn))
    np.testing.assert_array_equal(spans[:, 1], per_cell)
    factors = spans[:, 2:].copy().view(np.float32)
    np.testing.assert_allclose(factors[:, 0], 1 / kernel_run.splat_set.weighted.opacity_divisor)
    np.testing.assert_allclose(factors[:, 1], kernel_run.splat_set.weighted.background)
    keys_of_splats = kernel_run.words("keys of weighted", len(kernel_run.splat_set.data)).reshape(
        count, -1
    )
    actual = int((keys_of_splats[drawn] != NO_ID).sum())
    assert kernel_run.words("counts of cells", 6)[Counts.DRAWN] == actual


@pytest.mark.parametrize("name", ["many_cells", "far_beside"])
def test_cells_are_listed_for_their_tiles(renderer: Renderer, name: str) -> None:
    stages = ("project weighted", "project cells", "sort cells", "bin cells")
    kernel_run = run(renderer, name, *stages)
    count = len(kernel_run.splat_set.data.cells)
    pairs = int(kernel_run.words("counts of cells", 3)[Counts.PAIRS])
    tiles = kernel_run.words("keys of pairs of cells a", pairs)
    members = kernel_run.words("values of pairs of cells a", pairs)
    circles = kernel_run.floats("circles of cells", count).astype(np.float64)
    depth = cells(kernel_run).depth.astype(np.float32)
    assert (np.diff(depth[members]) >= 0).all()
    assert len(np.unique(members)) == kernel_run.words("counts of cells", 2)[Counts.VISIBLE]
    for i in np.unique(members):
        box = box_reference(circles[i, :2] + kernel_run.origin, circles[i, 2], (61, 47))
        np.testing.assert_array_equal(tiles[members == i], np.flatnonzero(box))
    assert pairs > 50


@pytest.mark.parametrize("name", ["many_cells", "divided_opacity", "finished_early"])
def test_weighted_sums_agree_with_the_reference(renderer: Renderer, name: str) -> None:
    scene, view_camera = WEIGHTED[name]()
    image = renderer.render(scene, view_camera).rgba
    run = Run(renderer, renderer._plan, scene.sets[0], view_camera)
    actual, sums = cells(run), splats(run)
    radii = circle_reference(dilated(actual), CELL_RADIUS_SIGMAS)
    per_cell = run.splat_set.data.per_cell
    order = np.argsort(actual.depth.astype(np.float32), kind="stable")
    nearest_first = [
        (
            slice(per_cell * i, per_cell * (i + 1)),
            box_reference(actual.mean[i] + run.origin, radii[i], (61, 47)),
        )
        for i in order
        if actual.drawn[i]
    ]
    weighted = run.splat_set.weighted
    expected = blend_wsr_reference(
        sums,
        circle_reference(dilated(sums), SPLAT_RADIUS_SIGMAS),
        nearest_first,
        (weighted.opacity_divisor, weighted.background),
        run.origin,
        (61, 47),
    )
    error = np.abs(image - expected)
    assert np.quantile(error, 0.995) <= 1e-5  # the rest is at thresholds
    assert error.max() <= 2e-2

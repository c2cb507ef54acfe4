"""Each kernel of weighted sums does what its NumPy twin does."""

from dataclasses import dataclass

import numpy as np
import pytest

from gsgen.runtime.kernels.project import project
from gsgen.runtime.kernels.project.project import SPLAT_REACH
from gsgen.runtime.kernels.project.project_cells import CELL_REACH
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import ABSENT
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
    one: SplatSet
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
    scene, seen_by = WEIGHTED[name]()
    renderer.render(scene, seen_by)
    placed = renderer.placed(scene)
    plan = renderer.plan(placed, seen_by, frozenset(["color"]))
    plan.submit(placed, seen_by, NOTHING_BEHIND, only=stages or None)
    plan.collect()
    return Run(renderer, plan, scene.sets[0], seen_by)


def splats(made: Run) -> Projected:
    one, n = made.one, len(made.one.data)
    page = project.page_uniform(one, made.seen_by, 0, n, one.data.count)
    page["per_cell"] = one.data.per_cell
    page["inverse_range"] = 0 if one.depth_range is None else 1 / one.depth_range
    frame = project.frame_uniform(made.seen_by, NOTHING_BEHIND)
    return project_reference(one.data, frame, page)


def cells(made: Run) -> Projected:
    """Cells as if they were Gaussians: opaque, where they are visible."""
    one, own = made.one, made.one.data.cells.copy()
    with np.errstate(invalid="ignore"):
        own[:, 3] = np.where(np.isfinite(own[:, 3]), own[:, 3] > 0, np.nan)
    bare = np.zeros((len(own), 3), np.float32)
    page = project.page_uniform(one, made.seen_by, 0, len(own), len(own))
    frame = project.frame_uniform(made.seen_by, NOTHING_BEHIND)
    return project_reference(SplatData(own, bare, "rgb"), frame, page)


def dilated(found: Projected) -> np.ndarray:
    """The 2D covariances behind conics; a ball where nothing is drawn."""
    conic = np.where(found.drawn[:, None], found.conic, [1.0, 0.0, 1.0])
    return np.linalg.inv(conic[:, [0, 1, 1, 2]].reshape(-1, 2, 2))


def whole(radius: np.ndarray, wanted: np.ndarray, covariance: np.ndarray, reach: float) -> None:
    """Radii are the same, or one apart where what is rounded up is nearly whole."""
    middle = np.trace(covariance, axis1=1, axis2=2) / 2
    apart = np.sqrt(np.maximum(0.1, middle**2 - np.linalg.det(covariance)))
    bare = reach * np.sqrt(middle + apart)
    sure = np.abs(bare - np.round(bare)) > 1e-4 * bare
    np.testing.assert_array_equal(radius[sure], wanted[sure])
    assert np.abs(radius - wanted).max() <= 1
    assert sure.mean() > 0.9


@pytest.mark.parametrize("name", ONE_SET)
def test_weighted_projection_agrees_with_the_reference(renderer: Renderer, name: str) -> None:
    made = run(renderer, name, "project weighted")
    wanted, n = splats(made), len(made.one.data)
    keys = made.words("keys of weighted", n)
    shapes, weights = made.floats("weighted shapes", n), made.floats("weighted weights", n)
    drawn = keys != ABSENT
    assert drawn.sum() > 20
    assert not (drawn & ~wanted.drawn).any()
    np.testing.assert_array_equal(weights[:, 1] >= 0, drawn)  # what blending goes by
    np.testing.assert_allclose(weights[drawn, 1], wanted.strength[drawn], atol=2e-5)
    np.testing.assert_allclose(weights[drawn, 2], wanted.depth[drawn], rtol=1e-5)
    size = np.abs(wanted.mean[drawn]).max() + 1
    np.testing.assert_allclose(shapes[drawn, :2], wanted.mean[drawn], atol=2e-6 * size)
    covariance = dilated(wanted)[drawn]
    circle = circle_reference(covariance, SPLAT_REACH)
    whole(np.sqrt(weights[drawn, 3]), circle, covariance, SPLAT_REACH)


@pytest.mark.parametrize("name", ONE_SET)
def test_projected_cells_agree_with_the_reference(renderer: Renderer, name: str) -> None:
    made = run(renderer, name, "project weighted", "project cells")
    wanted, count = cells(made), len(made.one.data.cells)
    keys, circles = (made.words("keys of cells a", count), made.floats("circles of cells", count))
    drawn = keys != ABSENT
    assert drawn.sum() > 10
    assert not (drawn & ~wanted.drawn).any()
    for i in np.flatnonzero(wanted.drawn & ~drawn):  # beside the image
        radius = circle_reference(dilated(wanted)[i : i + 1], CELL_REACH)[0]
        middle = wanted.mean[i] + made.origin
        assert not box_reference(middle, radius, (61, 47)).any()
    wanted_keys, wanted_lows = depth_reference(wanted.depth[drawn])
    np.testing.assert_array_equal(keys[drawn], wanted_keys)
    lows = made.words("lows of cells", count)
    np.testing.assert_array_equal(lows == ABSENT, ~drawn)
    rest = [decoded(each).astype(np.float64) for each in (lows[drawn], wanted_lows)]
    assert (np.abs(rest[0] - rest[1]) <= DEPTH_LEFT * wanted.depth[drawn]).all()
    covariance = dilated(wanted)[drawn]
    circle = circle_reference(covariance, CELL_REACH)
    whole(circles[drawn, 2], circle, covariance, CELL_REACH)
    for x, y, radius, tiles in circles[drawn].astype(np.float64):
        box = box_reference(np.array([x, y]) + made.origin, radius, (61, 47))
        assert box.sum() == tiles
    spans = made.words("spans of cells", 4 * count).reshape(count, 4)[drawn]
    per_cell = made.one.data.per_cell
    np.testing.assert_array_equal(spans[:, 0], per_cell * np.flatnonzero(drawn))
    np.testing.assert_array_equal(spans[:, 1], per_cell)
    factors = spans[:, 2:].copy().view(np.float32)
    np.testing.assert_allclose(factors[:, 0], 1 / made.one.weighted.opacity_divisor)
    np.testing.assert_allclose(factors[:, 1], made.one.weighted.background)
    keys_of_splats = made.words("keys of weighted", len(made.one.data)).reshape(count, -1)
    seen = int((keys_of_splats[drawn] != ABSENT).sum())
    assert made.words("counts of cells", 6)[Counts.DRAWN] == seen


@pytest.mark.parametrize("name", ["many_cells", "far_beside"])
def test_cells_are_listed_for_their_tiles(renderer: Renderer, name: str) -> None:
    stages = ("project weighted", "project cells", "sort cells", "bin cells")
    made = run(renderer, name, *stages)
    count = len(made.one.data.cells)
    pairs = int(made.words("counts of cells", 3)[Counts.PAIRS])
    tiles = made.words("keys of pairs of cells a", pairs)
    members = made.words("values of pairs of cells a", pairs)
    circles = made.floats("circles of cells", count).astype(np.float64)
    depth = cells(made).depth.astype(np.float32)
    assert (np.diff(depth[members]) >= 0).all()
    assert len(np.unique(members)) == made.words("counts of cells", 2)[Counts.VISIBLE]
    for i in np.unique(members):
        box = box_reference(circles[i, :2] + made.origin, circles[i, 2], (61, 47))
        np.testing.assert_array_equal(tiles[members == i], np.flatnonzero(box))
    assert pairs > 50


@pytest.mark.parametrize("name", ["many_cells", "divided_opacity", "finished_early"])
def test_weighted_sums_agree_with_the_reference(renderer: Renderer, name: str) -> None:
    scene, seen_by = WEIGHTED[name]()
    image = renderer.render(scene, seen_by).rgba
    made = Run(renderer, renderer._plan, scene.sets[0], seen_by)
    found, sums = cells(made), splats(made)
    radii = circle_reference(dilated(found), CELL_REACH)
    per_cell = made.one.data.per_cell
    order = np.argsort(found.depth.astype(np.float32), kind="stable")
    nearest_first = [
        (
            slice(per_cell * i, per_cell * (i + 1)),
            box_reference(found.mean[i] + made.origin, radii[i], (61, 47)),
        )
        for i in order
        if found.drawn[i]
    ]
    weighted = made.one.weighted
    wanted = blend_wsr_reference(
        sums,
        circle_reference(dilated(sums), SPLAT_REACH),
        nearest_first,
        (weighted.opacity_divisor, weighted.background),
        made.origin,
        (61, 47),
    )
    error = np.abs(image - wanted)
    assert np.quantile(error, 0.995) <= 1e-5  # the rest is at thresholds
    assert error.max() <= 2e-2

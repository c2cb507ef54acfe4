"""Culling and levels of detail are judged by pictures from where people stand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.arrays import f32, i32, i64
from gsgen.conformance.fixtures.builders.moving import camera_dependent_model
from gsgen.conformance.fixtures.builders.scenes import Kind, model_of_gaussians, pack, scene
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.probing.drawn_sample import spatial_groups
from gsgen.contract.rules.behaviour.coverage_pictures import Lens, draw_coverage
from gsgen.contract.spec.geometry import COVARIANCE_INDEX, look_at
from gsgen.contract.spec.layout import DecodedGaussians
from gsgen.contract.spec.manifest import CountOutput, Input
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

_ROWS = 360
_UPPER = COVARIANCE_INDEX
_INPUTS = (
    Input(name="view", role="view", default="identity"),
    Input(name="proj", role="projection", default="identity"),
    Input(name="size", role="viewport", default=(1280.0, 720.0)),
)
# Numbers of each row in front of a camera: x y z, the four of clip space, and the distance.
_CAMERA = (
    "eye = MatMul (homogeneous, view) x, y, z, one_of_four = Split <axis = 1> (eye, ones) "
    "clip = MatMul (eye, proj) u, v, w, s = Split <axis = 1> (clip, ones) "
    "across = Abs (x) along = Abs (y) left = Abs (u) down = Abs (v) "
    "place = Slice (eye, none, three, last) squares = Mul (place, place) "
    "square = ReduceSum <keepdims = 1> (squares, last) distance = Sqrt (square) "
    "wide = Mul (s, margin) ahead = Greater (z, small) "
    "width, height = Split (size, ones_of_two) "
)
_FRUSTUM = (
    "in_x = Less (left, wide) in_y = Less (down, wide) in_both = And (in_x, in_y) "
    "seen = And (in_both, ahead) "
)


def scene_with_camera(seen: str, kind: Kind = "room", *, has_levels: bool = False) -> ModelSpec:
    """Return a scene that hides rows; ``seen`` are nodes in ONNX text that tell which it draws.

    Args:
        seen: Nodes that compute ``seen``, bool [n, 1].
        kind: The scene.
        has_levels: Whether a coarse level follows, of the moments of groups of close rows.
    """
    parts = scene(kind, _ROWS, has_training=False)
    gaussians = pack(parts)
    if has_levels:
        groups = spatial_groups(parts.position, 5)
        center = np.stack([parts.position[group].mean(axis=0) for group in groups])
        spread = np.stack([np.cov(parts.position[group].T, bias=True) for group in groups])
        mean = np.stack([gaussians.covariance[group].mean(axis=0) for group in groups])
        assert gaussians.sh is not None
        gaussians = DecodedGaussians(
            position=np.concatenate([parts.position, center]),
            opacity=np.concatenate([parts.opacity, np.full(len(groups), 0.9)]),
            covariance=np.concatenate([gaussians.covariance, mean + spread[:, *_UPPER]]),
            sh=np.concatenate([gaussians.sh, gaussians.sh[[group[0] for group in groups]]]),
            rgb=None,
        )
    still = model_of_gaussians(gaussians)
    rows, count = still.weights["rows"], len(gaussians.position)
    body = still.body.replace(
        "gaussians = Identity (rows)",
        f"{_CAMERA} {seen} mask = Cast <to = 1> (seen) opacity_out = Mul (opacity, mask) "
        "gaussians = Concat <axis = 1> (position, opacity_out, covariance)",
    )
    weights = {name: array for name, array in still.weights.items() if name != "rows"}
    model = replace(
        still, inputs="float[4,4] view, float[4,4] proj, float[2] size", body=body, weights=weights
    )
    number = np.arange(count)
    is_fine, keeps = number < _ROWS, number % 12 == 0
    diagonal = float(np.linalg.norm(np.ptp(parts.position, axis=0)))
    return (
        model.with_weights(
            position=rows[:, :3],
            opacity=rows[:, 3:4],
            covariance=rows[:, 4:],
            homogeneous=np.c_[rows[:, :3], np.ones(count)].astype(np.float32),
            ones=i64(1, 1, 1, 1),
            ones_of_two=i64(1, 1),
            none=i64(0),
            three=i64(3),
            last=i64(1),
            small=f32(0.01),
            margin=f32(1.3),
            slope=f32(0.577),
            narrow=f32(0.25),
            train=f32(0.36),
            near_plane=f32(3),
            far_plane=f32(0.6 * diagonal),
            fine=is_fine[:, None],
            coarse=~is_fine[:, None],
            kept=keeps[:, None],
            switch=f32(0.75 * diagonal),
            a_third=f32(0.3),
            two=f32(2),
            tail=f32(0.02 * diagonal),
            offset_row=i64(3),
        )
        .with_manifest(inputs=_INPUTS)
        .with_outputs(count=CountOutput("num_points", "upper-bound"))
    )


def _thinned(close: str) -> str:
    """Return nodes that draw all rows where ``close`` is true, elsewhere a twelfth."""
    return f"{close} seen = Or (close, kept)"


_LEVELS = (
    "fine_here = And ({}, fine) coarse_here = And ({}, coarse) seen = Or (fine_here, coarse_here)"
)
_CLOSE = "close = Less (distance, switch) beyond = Not (close)"
HOLES = {
    "a near plane of three units": "seen = Greater (z, near_plane)",
    "intrinsics of the training camera": (
        "edge = Mul (z, train) in_x = Less (across, edge) in_y = Less (along, edge) "
        "seen = And (in_x, in_y)"
    ),
    "height before width": (
        "ratio = Div (width, height) edge = Mul (z, slope) lower = Mul (edge, ratio) "
        "in_x = Less (across, edge) in_y = Less (along, lower) in_both = And (in_x, in_y) "
        "seen = And (in_both, ahead)"
    ),
    "the frustum of a square picture": (
        "edge = Mul (z, slope) in_x = Less (across, edge) in_y = Less (along, edge) "
        "in_both = And (in_x, in_y) seen = And (in_both, ahead)"
    ),
    "half of the angle": (
        "edge = Mul (z, narrow) in_x = Less (across, edge) in_y = Less (along, edge) "
        "seen = And (in_x, in_y)"
    ),
    "one side of the picture": (
        f"{_FRUSTUM.replace('seen =', 'inside =')} edge = Mul (s, a_third) "
        "in_right = Less (u, edge) seen = And (inside, in_right)"
    ),
    "levels in the reverse order": _thinned("close = Greater (distance, switch)"),
    "levels by the squared distance": _thinned("close = Less (square, switch)"),
    "levels by the translation": _thinned(
        "row = Gather <axis = 0> (view, offset_row) start = Slice (row, none, three, last) "
        "way = Sub (position, start) ways = Mul (way, way) "
        "sum = ReduceSum <keepdims = 1> (ways, last) far_off = Sqrt (sum) "
        "close = Less (far_off, switch)"
    ),
}
NO_HOLES = {
    "the frustum and a margin": _FRUSTUM,
    "behind the camera": "seen = Identity (ahead)",
    "half spaces with a wide margin": (
        "edge = Mul (z, two) in_x = Less (across, edge) in_y = Less (along, edge) "
        "seen = And (in_x, in_y)"
    ),
    "a near plane of a fiftieth": "seen = Greater (z, tail)",
}


def findings(model: ModelSpec, folder: Path) -> list[str]:
    """Validate a model; return the rules that report something, but for inputs without effect."""
    path = folder / "m.onnx"
    model.write(path)
    report = validate(path)
    print([(finding.rule, finding.message) for finding in report.findings])
    return [finding.rule for finding in report.findings if finding.rule != "GI006"]


@pytest.mark.parametrize("name", HOLES)
def test_holes_are_noticed(name: str, tmp_path: Path) -> None:
    rules = findings(scene_with_camera(HOLES[name]), tmp_path)
    assert {"GB008", "GB067"} & set(rules)


def test_other_rules_name_a_transposed_view_and_a_reversed_axis(tmp_path: Path) -> None:
    transposed = (
        "turned = Transpose (view) wrong_eye = MatMul (homogeneous, turned) "
        "wrong_x, wrong_y, wrong_z, wrong_w = Split <axis = 1> (wrong_eye, ones) "
        "seen = Greater (wrong_z, small)"
    )
    assert findings(scene_with_camera(transposed), tmp_path) == ["GI007"]
    assert "GV054" in findings(scene_with_camera("seen = Less (z, small)"), tmp_path)


def test_a_far_plane_before_the_scene_leaves_what_is_behind_the_camera(tmp_path: Path) -> None:
    assert "GV054" in findings(scene_with_camera("seen = Less (z, far_plane)"), tmp_path)


def test_a_count_of_zero_is_no_fault_of_culling(tmp_path: Path) -> None:
    model = camera_dependent_model(40).with_weights(live=i32(0))
    assert findings(model, tmp_path) == ["GV032"]


def test_a_splat_covers_what_its_formula_says() -> None:
    sigma, opacity, distance = 0.3, 0.8, 4.0
    row = np.array([[0, 0, 0, opacity, sigma**2, 0, 0, sigma**2, 0, sigma**2]], float)
    view = look_at(np.array([0.0, 0.0, -distance]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
    coverage, depth = draw_coverage(row, view, Lens(1.5, 1.0), 0.1)
    x, y = np.meshgrid(*[(2 * np.arange(24) + 1) / 24 - 1] * 2)
    blur = 0.3 / 12**2
    spread = [(lens * sigma / distance) ** 2 for lens in (1.5, 1.0)]
    sharpness = np.sqrt(np.prod(spread) / np.prod([s + blur for s in spread]))
    squares = x**2 / (spread[0] + blur) + y**2 / (spread[1] + blur)
    np.testing.assert_allclose(coverage, opacity * sharpness * np.exp(-squares / 2), atol=1e-6)
    np.testing.assert_allclose(depth[coverage > 1e-6], distance)


def test_a_row_behind_another_is_covered_by_it() -> None:
    near, far = (np.array([[0, 0, z, 0.5, 1e4, 0, 0, 1e4, 0, 1e-4]], float) for z in (2.0, 6.0))
    coverage, depth = draw_coverage(np.vstack([far, near]), np.eye(4), Lens(1.0, 1.0), 0.1)
    np.testing.assert_allclose(coverage, 0.75, atol=1e-3)
    np.testing.assert_allclose(depth, (0.5 * 2 + 0.25 * 6) / 0.75, rtol=1e-2)


@pytest.mark.parametrize("kind", ["room", "avatar", pytest.param("cloud", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", NO_HOLES)
def test_rows_out_of_view_leave_no_hole(name: str, kind: Kind, tmp_path: Path) -> None:
    assert not findings(scene_with_camera(NO_HOLES[name], kind), tmp_path)


@pytest.mark.parametrize("kind", ["room", "surface"])
def test_levels_of_detail_that_replace_each_other_pass(kind: Kind, tmp_path: Path) -> None:
    levels = f"{_CLOSE} {_LEVELS.format('close', 'beyond')}"
    assert not findings(scene_with_camera(levels, kind, has_levels=True), tmp_path)


@pytest.mark.parametrize("kind", ["room", "surface"])
def test_levels_of_detail_in_the_reverse_order_are_noticed(kind: Kind, tmp_path: Path) -> None:
    levels = f"{_CLOSE} {_LEVELS.format('beyond', 'close')}"
    assert findings(scene_with_camera(levels, kind, has_levels=True), tmp_path) == ["GB067"]


def test_a_part_of_the_rows_that_follows_the_camera_is_told(tmp_path: Path) -> None:
    whole = find("rows_relative_to_camera").draw()
    model = whole.replace_text(
        "moved = Add (center, back)", "part = Mul (back, follows) moved = Add (center, part)"
    ).with_weights(follows=(np.arange(40)[:, None] % 4 == 0).astype(np.float32))
    model.write(tmp_path / "m.onnx")
    report = validate(tmp_path / "m.onnx", Settings(level=Level.VALUES))
    (finding,) = (finding for finding in report.findings if finding.rule == "GV059")
    assert "the centres of 25% of the rows are relative to the camera's centre" in finding.message

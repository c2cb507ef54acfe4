"""Fields of a row belong together in every run: order of rows, and sizes against distances."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.arrays import f32, i64
from gsgen.conformance.fixtures.builders.scenes import Kind, model_of_gaussians, pack, scene
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.conformance.fixtures.pictures.poses import arms_on_a_trunk
from gsgen.contract.probing.drawn_sample import spatial_groups
from gsgen.contract.spec.manifest import Bounds, CountOutput, Input
from gsgen.contract.validator import validate

_ROWS = 160
_VIEW = Input(name="view", role="view", default="identity")
_TIME = Input(name="time", role="time", range=(0.0, 1.0), default=0.0)
_WIDE = Bounds((-12.0, -12.0, -12.0), (12.0, 12.0, 12.0))
_UNSORTED = {"position": "places", "opacity": "places", "covariance": "places", "color": "places"}


def findings(model: ModelSpec, folder: Path, *rules: str) -> set[str]:
    """Validate a model; return which of the rules report something."""
    path = folder / "m.onnx"
    model.write(path)
    report = validate(path)
    assert all(report.outcome(rule).status in ("pass", "fail") for rule in rules)
    return {finding.rule for finding in report.findings} & set(rules)


def by_parts(kind: Kind, nodes: str, entry: Input, degree: int | None = 0) -> ModelSpec:
    """Return a scene with an input, whose fields are outputs of nodes in ONNX text.

    The nodes take ``position``, ``opacity``, ``covariance`` and ``colors``, and give ``position_out``
    and the others.
    """
    still = model_of_gaussians(pack(scene(kind, _ROWS), degree))
    rows = still.weights["rows"]
    shape = "4,4" if entry.role == "view" else "1"
    body = still.body.replace("color = Identity (colors)", nodes).replace(
        "gaussians = Identity (rows)",
        "gaussians = Concat <axis = 1> (position_out, opacity_out, covariance_out)",
    )
    packed, _, rest = body.partition("covariance_out)")
    dtype = "int32" if entry.role == "frame_index" else "float"
    model = replace(
        still,
        inputs=f"{dtype}[{shape}] {entry.name}",
        body=f"{rest} {packed}covariance_out)",
        weights={name: array for name, array in still.weights.items() if name != "rows"},
    )
    return model.with_weights(
        position=rows[:, :3], opacity=rows[:, 3:4], covariance=rows[:, 4:]
    ).with_manifest(inputs=(entry,), bounds=_WIDE)


_DEPTH = (
    "offset = Gather <axis = 0> (view, three) eye = MatMul (homogeneous, view) "
    "column = Gather <axis = 1> (eye, two) depth = Reshape (column, flat) "
    "sorted, places = TopK (depth, all) "
    "rank = Cast <to = 1> (places) ranks, inverse = TopK <largest = 0> (rank, all) "
    "as_they_are = Identity (order) "
    "head = Slice (places, zero, third) tail = Slice (order, third, all) "
    "a_third = Concat <axis = 0> (tail, head) "
)


def sorted_by_depth(degree: int | None = 0, *, lit: bool = False, **indices: str) -> ModelSpec:
    """Return a room whose rows are sorted by their depth, each field by some indices."""
    chosen = _UNSORTED | indices
    gathers = " ".join(
        f"{field}_out = Gather <axis = 0> ({field}, {chosen[field]})"
        for field in ("position", "opacity", "covariance")
    )
    color = f"ordered = Gather <axis = 0> (colors, {chosen['color']}) color = Identity (ordered)"
    if lit:
        color = (
            "scaled = Mul (depth, small) one_column = Unsqueeze (scaled, last) "
            "shine = Sigmoid (one_column) shown = Mul (colors, shine) "
            f"color = Gather <axis = 0> (shown, {chosen['color']})"
        )
    model = by_parts("room", f"{_DEPTH} {gathers} {color}", _VIEW, degree)
    center = model.weights["position"]
    return model.with_weights(
        homogeneous=np.c_[center, np.ones(_ROWS)].astype(np.float32), three=i64(3), two=i64(2),
        flat=i64(-1), all=i64(_ROWS), order=np.arange(_ROWS), zero=i64(0), third=i64(_ROWS // 3),
        small=f32(0.05), last=i64(1),
    )  # fmt: skip


def compacted(color: str) -> ModelSpec:
    """Return a room that keeps its farther rows, without gaps; colours by some indices."""
    keep = (
        "ahead = Greater (depth, middle) mask = Cast <to = 1> (ahead) "
        "score = Mul (mask, falling) best, places = TopK (score, all) "
        "kept = Gather <axis = 0> (mask, places) visible = Unsqueeze (kept, last) "
        "opacity_all = Gather <axis = 0> (opacity, places) opacity_out = Mul (opacity_all, visible) "
    )
    model = sorted_by_depth(color=color)
    model = model.replace_text("opacity_out = Gather <axis = 0> (opacity, places)", "")
    # Cameras orbit 2.2 half diagonals away from the centre of the bounds.
    middle = 2.2 * np.linalg.norm(_WIDE.max)
    return (
        model.replace_text("sorted, places = TopK (depth, all) ", keep)
        .with_outputs(count=CountOutput("num_points", "upper-bound"))
        .with_weights(middle=f32(float(middle)), falling=np.arange(_ROWS, 0, -1).astype(np.float32))
    )


def drifting_and_sorted(color: str) -> ModelSpec:
    """Return a room that moves with time, sorted by its height; colours by some indices."""
    nodes = (
        "shift = Mul (speed, time) moved = Add (position, shift) "
        "column = Gather <axis = 1> (moved, two) height = Reshape (column, flat) "
        "sorted, places = TopK (height, all) as_they_are = Identity (order) "
        "position_out = Gather <axis = 0> (moved, places) "
        "opacity_out = Gather <axis = 0> (opacity, places) "
        "covariance_out = Gather <axis = 0> (covariance, places) "
        f"color = Gather <axis = 0> (colors, {color})"
    )
    model = by_parts("room", nodes, _TIME)
    speed = np.random.default_rng(2).normal(0, 0.4, (_ROWS, 3)).astype(np.float32)
    return model.with_weights(
        speed=speed, two=i64(2), flat=i64(-1), all=i64(_ROWS), order=np.arange(_ROWS)
    )


TORN = {
    "colours stay": sorted_by_depth(color="as_they_are"),
    "colours of degree 1 stay": sorted_by_depth(1, color="as_they_are"),
    "lit colours stay": sorted_by_depth(None, lit=True, color="as_they_are"),
    "covariances stay": sorted_by_depth(covariance="as_they_are"),
    "opacities stay": sorted_by_depth(opacity="as_they_are"),
    "positions stay": sorted_by_depth(position="as_they_are"),
    "colours by the inverse": sorted_by_depth(color="inverse"),
    "colours of two thirds stay": sorted_by_depth(color="a_third"),
    "colours stay where rows are dropped": compacted("as_they_are"),
    "colours stay while the scene moves": drifting_and_sorted("as_they_are"),
}
WHOLE = {
    "sorted": sorted_by_depth(),
    "sorted, degree 1": sorted_by_depth(1),
    "sorted and lit": sorted_by_depth(None, lit=True),
    "not sorted, but lit": sorted_by_depth(
        None, lit=True, **dict.fromkeys(_UNSORTED, "as_they_are")
    ),
    "dropped rows": compacted("places"),
    "sorted while the scene moves": drifting_and_sorted("places"),
}


@pytest.mark.parametrize("name", TORN)
def test_a_field_that_is_not_sorted_along_is_noticed(name: str, tmp_path: Path) -> None:
    assert findings(TORN[name], tmp_path, "GB065") == {"GB065"}


@pytest.mark.parametrize("name", WHOLE)
def test_rows_that_move_as_a_whole_pass(name: str, tmp_path: Path) -> None:
    assert not findings(WHOLE[name], tmp_path, "GB065")


def test_whole_gaussians_at_other_places_than_their_colours_are_an_error(tmp_path: Path) -> None:
    frame = Input(name="frame", role="frame_index", range=(0.0, 15.0), default=0, frames=16)
    fields = ("position", "opacity", "covariance")
    gathered = " ".join(f"{name}_out = Gather <axis = 0> ({name}, order)" for name in fields)
    nodes = (
        "step = Cast <to = 7> (frame) steps = Mul (step, seven) ahead = Add (places, steps) "
        f"order = Mod (ahead, total) {gathered} color = Identity (colors)"
    )
    model = by_parts("room", nodes, frame).with_weights(
        places=np.arange(_ROWS), seven=i64(7), total=i64(_ROWS)
    )
    # Lights that run along still lamps, of which a few sway, may be meant.
    running = (
        "step = Cast <to = 7> (frame) steps = Mul (step, seven) ahead = Add (places, steps) "
        "order = Mod (ahead, total) lit = Gather <axis = 0> (colors, order) color = Identity (lit) "
        "real = Cast <to = 1> (frame) shift = Mul (real, sway) position_out = Add (position, shift) "
        "opacity_out = Identity (opacity) covariance_out = Identity (covariance)"
    )
    lights = by_parts("room", running, frame).with_weights(
        places=np.arange(_ROWS), seven=i64(7), total=i64(_ROWS),
        sway=np.where(np.arange(_ROWS)[:, None] < 3, f32(0.01), f32(0)),
    )  # fmt: skip
    path = tmp_path / "m.onnx"
    for told, certainty in ((model, "confirmed"), (lights, "possible")):
        told.write(path)
        report = validate(path)
        assert [(f.rule, f.certainty) for f in report.findings][:1] == [("GB065", certainty)]


def scaled(
    kind: Kind, distances: float, sizes: float, *, part: float = 1.0, entry: Input = _TIME
) -> ModelSpec:
    """Return a scene whose distances and sizes grow with an input by factors.

    Args:
        kind: The scene.
        distances: Factor of positions at the end of the input's range.
        sizes: Factor of standard deviations there.
        part: Share of the scene, by its x coordinate, in which sizes do so; elsewhere they grow as
            distances do.
        entry: The input, which goes from 0 to 1.
    """
    value = (
        "real = Cast <to = 1> (time)" if entry.role == "frame_index" else "real = Identity (time)"
    )
    nodes = (
        f"{value} far = Mul (real, spread) factor = Add (far, one) "
        "position_out = Mul (position, factor) growth = Mul (logarithms, real) "
        "growths = Exp (growth) covariance_out = Mul (covariance, growths) "
        "opacity_out = Identity (opacity) color = Identity (colors)"
    )
    model = by_parts(kind, nodes, entry)
    x = model.weights["position"][:, 0]
    logarithm = 2 * np.log(np.where(x <= np.quantile(x, part), sizes, distances))
    return model.with_weights(
        spread=f32(distances - 1), one=f32(1), logarithms=logarithm[:, None].astype(np.float32)
    )


_FRAME = Input(name="time", role="frame_index", range=(0.0, 1.0), default=0.0)
OTHER_FACTORS = {
    "positions alone normalised": scaled("surface", 0.286, 1.0),
    "positions alone multiplied": scaled("avatar", 3.0, 1.0),
    "sizes pulse": scaled("surface", 1.0, 2.9),
    "sizes of strands pulse": scaled("hair", 1.0, 2.9),
    "sizes vanish": scaled("cloud", 1.0, 0.3),
    "variances multiplied once": scaled("surface", 4.0, 2.0),
    "variances multiplied four times": scaled("room", 3.0, 9.0),
    "half of the scene": scaled("room", 0.3, 1.0, part=0.5),
    "in whole frames": scaled("avatar", 0.286, 1.0, entry=_FRAME),
}
SAME_FACTORS = {
    "scaled": scaled("surface", 0.3, 0.3),
    "still": scaled("avatar", 1.0, 1.0),
    "breathing": scaled("avatar", 1.2, 1.0),
    "sizes by a third": scaled("hair", 1.0, 1.35),
    "a tenth of the scene": scaled("room", 1.0, 3.0, part=0.1),
}


@pytest.mark.parametrize("name", OTHER_FACTORS)
def test_sizes_that_do_not_follow_distances_are_noticed(name: str, tmp_path: Path) -> None:
    assert findings(OTHER_FACTORS[name], tmp_path, "GB066") == {"GB066"}


@pytest.mark.parametrize("name", SAME_FACTORS)
def test_sizes_that_follow_distances_pass(name: str, tmp_path: Path) -> None:
    assert not findings(SAME_FACTORS[name], tmp_path, "GB066")


@pytest.mark.parametrize("count", [1, 7, 16, 33, 500])
def test_spatial_groups_are_a_partition_into_boxes(count: int) -> None:
    position = np.random.default_rng(count).normal(size=(count, 3))
    groups = spatial_groups(position, 8)
    assert sorted(np.concatenate(groups).tolist()) == list(range(count))
    assert all(8 <= len(group) < 16 for group in groups) or count < 16
    boxes = [np.ptp(position[group], axis=0).prod() for group in groups]
    assert sum(boxes) <= np.ptp(position, axis=0).prod() * (1 + 1e-9)


def test_covariances_of_one_arm_that_stay_are_noticed(tmp_path: Path) -> None:
    model = arms_on_a_trunk.draw()
    body = "both = MatMul (half, back)"
    turned = "all_turned = MatMul (half, back) both = Where (is_left_arm, sigma, all_turned)"
    is_left_arm = (model.weights["limb"] == 1)[:, None, None]
    torn = model.replace_text(body, turned).with_weights(is_left_arm=is_left_arm)
    assert findings(torn, tmp_path, "GB035") == {"GB035"}

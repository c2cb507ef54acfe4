"""Poses are judged by turning joints: by which angle, about which axis and point, in which order."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.arrays import i64
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import GeneratorManifest, Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validator import validate

_CROSS = "nine = MatMul (pose, cross)"
_LOCAL = "local = Add (near, second)"
_CHILDREN = "left_whole = MatMul (trunk, left) right_whole = MatMul (trunk, right)"
_MOVED = "moved = Reshape (column, vectors)"


def read_as(nodes: str) -> dict[str, str]:
    """Replace the pose in Rodrigues' formula by what nodes make of it."""
    return {"squares = Mul (pose, pose)": f"{nodes} squares = Mul (read, read)",
            _CROSS: _CROSS.replace("pose", "read")}  # fmt: skip


# Fault: texts to replace, the rule that notices, and words of the report.
FAULTS: dict[str, tuple[dict[str, str], str, str]] = {
    "degrees": (read_as("read = Mul (pose, degree)"), "GB068", "taken for degrees"),
    "times 57.3": (read_as("read = Div (pose, degree)"), "GB068", "multiplied by 180/π"),
    "half angles": (read_as("read = Mul (pose, half_one)"), "GB068", "halved"),
    "inverse": ({_LOCAL: "other = Add (near, second) "
                 "local = Transpose <perm = [0, 2, 1]> (other)"}, "GB068", "inverted"),
    # I + [v]×, which is no rotation.
    "small angles": ({_LOCAL: "local = Mul (near, unit)",
                      "first = Mul (sine_factor, skew)": "first = Mul (skew, unit)"},
                     "GB068", "holds for small angles"),
    "covariances turned backwards": (
        {"half = MatMul (turn, sigma) both = MatMul (half, back)":
         "half = MatMul (back, sigma) both = MatMul (half, turn)"},
        "GB068", "turn the other way"),
    "left-handed": (read_as("read = Mul (pose, signs)"), "GB036", "x −y −z"),
    "z x y": (read_as("read = Gather <axis = 1> (pose, zxy)"), "GB036", "z x y"),
    "global rotations": (
        {_CHILDREN: "left_whole = Identity (left) right_whole = Identity (right)",
         "carried_joints = MatMul (trunk, joint_offsets) joints_at = Add (carried_joints, root)":
         "joints_at = Identity (joints)"},
        "GB061", "move with its parent"),
    # As above, where the rows near the trunk hang on both.
    "global rotations, softly skinned": (
        {_CHILDREN: "left_whole = Identity (left) right_whole = Identity (right)",
         "carried_joints = MatMul (trunk, joint_offsets) joints_at = Add (carried_joints, root)":
         "joints_at = Identity (joints)",
         _MOVED: "whole = Reshape (column, vectors) on_trunk = MatMul (trunk, center) "
         "trunk_shift = Gather <axis = 0> (shifts, zero) trunk_column = Add (on_trunk, trunk_shift) "
         "by_trunk = Reshape (trunk_column, vectors) gap = Sub (by_trunk, whole) "
         "part = Mul (gap, share) moved = Add (whole, part)"},
        "GB061", "move with its parent"),
    "children before parents": (
        {_CHILDREN: "left_whole = MatMul (left, trunk) right_whole = MatMul (right, trunk)"},
        "GB061", "turned before it"),
    "about the origin": (
        {"shifts = Sub (joints_at, turned_joints)": "shifts = Sub (joints_at, joints_at)"},
        "GB060",
        "another point",
    ),
    "rows shrunk": ({_MOVED: "whole = Reshape (column, vectors) moved = Mul (whole, shrink)"},
                    "GB060", "another point"),
}  # fmt: skip
RIGHT: dict[str, dict[str, str]] = {
    "as it is": {},
    "rows moved": {_MOVED: "whole = Reshape (column, vectors) moved = Mul (whole, unit)"},
}


def altered(texts: dict[str, str]) -> ModelSpec:
    model = find("arms_on_a_trunk").draw()
    for old, new in texts.items():
        model = model.replace_text(old, new)
    near_trunk = np.arange(len(model.weights["center"])) % 5 == 0
    return model.with_weights(
        share=0.5 * near_trunk[:, None].astype(np.float32), zero=np.array([0], np.int64),
        degree=np.array([np.pi / 180], np.float32), half_one=np.array([0.5], np.float32), shrink=np.array([0.4], np.float32),
        unit=np.array([1], np.float32), signs=np.array([[1, -1, -1]], np.float32), zxy=np.array([2, 0, 1], np.int64),
    )  # fmt: skip


def declared_pose() -> Input:
    manifest = find("arms_on_a_trunk").draw().manifest
    assert isinstance(manifest, GeneratorManifest)
    return manifest.inputs[0]


def reported(model: ModelSpec, folder: Path) -> list[tuple[str, str]]:
    path = folder / "m.onnx"
    model.write(path)
    findings = validate(path).findings
    return [(f.rule, f.message) for f in findings if f.severity is not Severity.INFO]


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_the_skeleton_is_named_first(name: str, tmp_path: Path) -> None:
    texts, rule, words = FAULTS[name]
    first_rule, message = reported(altered(texts), tmp_path)[0]
    assert first_rule == rule
    assert words in message


@pytest.mark.parametrize("name", RIGHT)
def test_right_skeletons_have_no_finding(name: str, tmp_path: Path) -> None:
    assert reported(altered(RIGHT[name]), tmp_path) == []


def test_joints_stand_where_declared_whichever_place_the_root_has_by_default(
    tmp_path: Path,
) -> None:
    person = find("arms_on_a_trunk").draw()
    moved = (
        "whole = Reshape (column, vectors) back_of = Transpose (placing) "
        "placed = MatMul (whole, back_of) moved = Add (placed, place)"
    )
    place = Input(name="place", role="root_translation", shape=(3,), default=(0.0, 0.6, 0.0))
    upright = (1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0)
    placing = Input(
        name="placing", role="root_rotation", convention="matrix", shape=(3, 3), default=upright
    )
    turned = "back_whole = MatMul (placing, both) both_placed = MatMul (back_whole, back_of)"
    model = person.replace_text(_MOVED, moved).replace_text(
        "nines = Reshape (both,", f"{turned} nines = Reshape (both_placed,"
    )
    model = replace(model, inputs=f"{model.inputs}, float[3] place, float[3,3] placing")
    assert reported(model.with_manifest(inputs=(declared_pose(), place, placing)), tmp_path) == []


def test_a_body_of_two_roots_turns_about_either(tmp_path: Path) -> None:
    trunk, left, right = declared_pose().joints
    joints = (replace(left, parent=None), trunk, right)
    turning = Input(name="turning", role="root_rotation", shape=(3,), default="zeros")
    nodes = (
        "row = Reshape (turning, one_row) whole = Concat <axis = 0> (row, others) "
        "in_order = Gather <axis = 0> (pose, order) read = Add (in_order, whole)"
    )
    model = altered(read_as(nodes)).with_weights(
        one_row=i64(1, 3), others=np.zeros((2, 3), np.float32), order=i64(1, 0, 2)
    )
    model = replace(model, inputs=f"{model.inputs}, float[3] turning")
    inputs = (replace(declared_pose(), joints=joints), turning)
    assert reported(model.with_manifest(inputs=inputs), tmp_path) == []


def test_a_pose_without_joints_is_turned_too(tmp_path: Path) -> None:
    model = altered(FAULTS["degrees"][0])
    pose = Input(name="pose", role="pose", convention="axis-angle", shape=(3, 3), default="zeros")
    assert reported(model.with_manifest(inputs=(pose,)), tmp_path)[0][0] == "GB068"
    assert reported(find("arms_on_a_trunk").draw().with_manifest(inputs=(pose,)), tmp_path) == []

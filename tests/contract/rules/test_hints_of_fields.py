"""Hints that name a manifest field and its value mend the finding, and are absent where none does."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.images import darken
from gsgen.conformance.fixtures.builders.moving import input_driven_model
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.conformance.fixtures.valid.companions import trajectory
from gsgen.contract.spec.manifest import AppearanceOutput, Bounds, CountOutput, Input
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate


def findings(model: ModelSpec, folder: Path, level: Level = Level.STATIC) -> tuple[Finding, ...]:
    path = folder / "m.onnx"
    model.write(path)
    return validate(path, Settings(level=level)).findings


def predicted(outputs: str, **fields: object) -> ModelSpec:
    """Return a predictor with other graph outputs, and other fields of the declared ones."""
    model = trajectory.draw().replace_text("float[3,7] future, float[3,7] sigma", outputs)
    return model.edit_manifest(
        lambda manifest: [manifest["outputs"][path.split("_")[0]].update({path.split("_")[1]: value})
                          for path, value in fields.items()]
    )  # fmt: skip


AS_DRAWN = "float[3,7] future, float[3,7] sigma"
CLOCK = "float[1] clock"
STATES = {
    "steps": (predicted(AS_DRAWN, future_steps=4), ["Set outputs.future.steps to 3."] * 2),
    "rows of one output": (predicted("float[3,7] future, float[4,7] sigma"), []),
    "representation": (
        predicted(AS_DRAWN, future_representation="position+axis-angle"),
        ['Set outputs.future.representation to "position+quaternion-wxyz".'],
    ),
    "semantics": (
        predicted(AS_DRAWN, uncertainty_semantics="covariance-upper"),
        ['Set outputs.uncertainty.semantics to "standard-deviation".'],
    ),
    "no size of any semantics": (predicted("float[3,7] future, float[3,9] sigma"), []),
}
PICTURES = {
    "scale": (
        darken("8,12").edit_manifest(lambda fields: fields["outputs"]["image"].update(scale=2)),
        ["Set outputs.image.scale to 1."],
    ),
    "channels": (darken("8,12").replace_text("float[1,3,8,12] out", "float[1,5,8,12] out"), []),
}


def _clocks(*names: str) -> ModelSpec:
    entries = tuple(Input(name=name, role="control", range=(0.0, 1.0)) for name in names)
    return input_driven_model(CLOCK, entries, "shift = Mul (speed, clock)")


NAMES = {
    "one input": (_clocks("zeit"), ['Set inputs.0.name to "clock".']),
    "two inputs for one name": (_clocks("zeit", "größe"), []),
    "an optional output": (
        still().with_outputs(
            count=CountOutput("gaussians", "upper-bound"),
            appearance=AppearanceOutput("gaussians", "sh", 0),
        ),
        ["Remove outputs.count, or name the tensor that is meant."],
    ),
}
CASES = STATES | PICTURES | NAMES


@pytest.mark.parametrize("name", CASES)
def test_a_field_is_named_where_it_mends(name: str, tmp_path: Path) -> None:
    model, expected = CASES[name]
    hints = [finding.hint for finding in findings(model, tmp_path)]
    assert hints
    assert [hint for hint in hints if hint.startswith(("Set ", "Remove "))] == expected


def test_removals_from_a_list_come_last_first(tmp_path: Path) -> None:
    hints = [finding.hint for finding in findings(_clocks("a", "clock", "b"), tmp_path)]
    paths = [hint.split("remove ")[1] for hint in hints if "remove inputs" in hint]
    assert paths == ["inputs.2.", "inputs.0."]


def test_a_field_of_a_wrong_type_is_named_at_any_depth(tmp_path: Path) -> None:
    def break_range(fields: dict[str, Any]) -> None:
        fields["inputs"][0]["range"][1] = "x"

    (finding,) = findings(find("drift").draw().edit_manifest(break_range), tmp_path)
    assert (finding.rule, finding.where.subject) == ("GM002", "manifest inputs.0.range.1")


def test_a_field_that_the_schema_lacks_is_removed_alone(tmp_path: Path) -> None:
    model = _clocks("clock").edit_manifest(lambda fields: fields["inputs"][0].update(speed=2))
    (hint,) = [finding.hint for finding in findings(model, tmp_path)]
    assert hint == "Remove inputs.0.speed, or correct its name."


def test_inputs_are_not_removed_for_a_fault_of_one(tmp_path: Path) -> None:
    model = _clocks("clock").edit_manifest(lambda fields: fields["inputs"][0].update(rate="x"))
    (hint,) = [finding.hint for finding in findings(model, tmp_path)]
    assert hint.startswith("Correct the field named here")


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e5])
def test_bounds_of_a_hint_hold_the_scene(size: float, tmp_path: Path) -> None:
    rows = still().weights["rows"] * np.array([*[size] * 3, 1, *[size**2] * 6], np.float32)
    scene = still().with_weights(rows=rows)
    wide = scene.with_manifest(bounds=Bounds((-1e9,) * 3, (1e9,) * 3))
    (hint,) = (f.hint for f in findings(wide, tmp_path, Level.VALUES) if f.rule == "GV065")
    corners = json.loads(hint.removeprefix("Set bounds to ").removesuffix("."))
    assert (np.array(corners["min"]) <= rows[:, :3].min(0)).all()
    assert (np.array(corners["max"]) >= rows[:, :3].max(0)).all()
    mended = scene.with_manifest(bounds=Bounds(tuple(corners["min"]), tuple(corners["max"])))
    rules = {finding.rule for finding in findings(mended, tmp_path, Level.VALUES)}
    assert not rules & {"GV065", "GV021", "GM019"}

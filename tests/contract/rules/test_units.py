"""The first operations on a time or a picture tell the range that a network was trained with."""

from pathlib import Path

import numpy as np
import onnx
import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.arrays import f32
from gsgen.conformance.fixtures.builders.moving import input_driven_model
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

NUMBERS = {"one": 1.0, "half": 0.5, "two": 2.0, "milli": 1e-3,
           "radians": 2 * np.pi, "zero": 0.0}  # fmt: skip
# Nodes from the time to u, its range, and words of the finding; empty where none is due.
FIRST_NODES = {
    "as it is": ("u = Identity (time)", (0.0, 1.0), ""),
    "signed": ("a = Add (time, one) u = Mul (a, half)", (0.0, 1.0), "[-1, 1]"),
    "signed, divided": ("a = Add (one, time) u = Div (a, two)", (0.0, 1.0), "[-1, 1]"),
    "signed, then faster": ("a = Add (time, one) b = Mul (a, half) u = Mul (b, radians)", (0.0, 1.0), "[-1, 1]"),
    "signed as declared": ("a = Add (time, one) u = Mul (a, half)", (-1.0, 1.0), ""),
    "a fade from a half": ("a = Mul (time, half) u = Add (a, half)", (0.0, 1.0), ""),
    "unit": ("a = Mul (time, two) u = Sub (a, one)", (-1.0, 1.0), "[0, 1]"),
    "unit as declared": ("a = Mul (time, two) u = Sub (a, one)", (0.0, 1.0), ""),
    "milliseconds": ("u = Mul (time, milli)", (0.0, 2.0), "milliseconds"),
    "milliseconds as declared": ("u = Mul (time, milli)", (0.0, 2000.0), ""),
    "radians": ("a = Mul (time, radians) u = Sin (a)", (0.0, 1.0), ""),
    "from its start": ("a = Sub (time, zero) b = Div (a, two) u = Cast <to = 1> (b)", (0.0, 2.0), ""),
}  # fmt: skip


def units_told(model: ModelSpec, folder: Path) -> str:
    """Return what the rule of units reports, statically."""
    path = folder / "m.onnx"
    model.write(path)
    report = validate(path, Settings(level=Level.STATIC))
    return " ".join(finding.message for finding in report.findings if finding.rule == "GI037")


@pytest.mark.parametrize("name", FIRST_NODES)
def test_the_range_of_the_first_operations_is_told(name: str, tmp_path: Path) -> None:
    nodes, ends, words = FIRST_NODES[name]
    time = Input(name="time", role="time", range=ends, default=ends[0])
    model = input_driven_model("float[1] time", time, f"{nodes} shift = Mul (speed, u)")
    weights = {key: np.array([value], np.float32) for key, value in NUMBERS.items()}
    told = units_told(model.with_weights(**weights), tmp_path)
    assert words in told
    assert bool(words) is bool(told)


@pytest.mark.parametrize(("step", "is_told"), [(0.1, False), (10.0, False), (100.0, True)])
def test_steps_in_milliseconds_are_told(step: float, is_told: bool, tmp_path: Path) -> None:
    model = find("trajectory").draw().edit_manifest(lambda fields: fields.update(step_seconds=step))
    assert bool(units_told(model, tmp_path)) is is_told


def test_graphs_that_are_no_graphs_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0)
    nodes = "u = Mul (time, half) shift = Mul (speed, u)"
    input_driven_model("float[1] time", time, nodes).with_weights(half=f32(0.5)).write(path)
    graph = onnx.load(path)
    del next(node for node in graph.graph.node if "time" in node.input).output[:]
    onnx.save(graph, path)
    outcomes = validate(path, Settings(level=Level.STATIC)).outcomes
    assert not [outcome.rule.id for outcome in outcomes if outcome.status == "crashed"]

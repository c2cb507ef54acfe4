"""Generators of pictures: cameras, lenses and colours taken otherwise than declared are noticed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.arrays import f32, i64
from gsgen.conformance.fixtures.builders.pixels import pixel_model
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.validator import validate

_COLORS = "colors = Reshape ({}, color_shape)"
# Nodes that make a mistake, weights, the rule, and words of its finding.
FAULTS: dict[str, tuple[dict[str, str], dict[str, np.ndarray], str, str]] = {
    "camera to world": (
        {"centers": "moved = MatMul (local, turned) centers = Add (moved, translations)"},
        {},
        "GB070",
        "camera-to-world",
    ),
    "OpenGL's axes": (
        {"rays": "forward = Concat <axis = 2> (slopes, ahead) rays = Mul (forward, opengl)"},
        {"opengl": f32(1, -1, -1)},
        "GB070",
        "behind the cameras",
    ),
    "fractions": (
        {"lens": "lens = Mul (lenses, sizes)"},
        {"sizes": np.array([[[8, 1, 8], [1, 6, 6], [1, 1, 1]]], np.float32)},
        "GB070",
        "fractions",
    ),
    "in the space of the camera": (
        {"centers": "away = Mul (offsets, zero) centers = Add (local, away)"},
        {},
        "GB070",
        "stay in the space",
    ),
    "in the space of the first camera": (
        {"centers": "world = MatMul (offsets, rotations) "
                    "turn = Gather <axis = 0> (turned, none) shift = Gather <axis = 0> (translations, none) "
                    "ahead_of = MatMul (world, turn) centers = Add (ahead_of, shift)"},
        {"none": i64(0)},
        "GB070",
        "stay in the space",
    ),
    "cameras at a mean distance of 1": (
        {"centers": "lengths = ReduceL2 (translations, axis_2) mean = ReduceMean (lengths, none) "
                    "some = Max (mean, least) nearer = Div (translations, some) "
                    "around = Sub (local, nearer) centers = MatMul (around, rotations)"},
        {"none": i64(0)},
        "GB070",
        "divided by their mean",
    ),
    "camera to world, and clamped": (
        {"centers": "moved = MatMul (local, turned) free = Add (moved, translations) "
                    "centers = Clip (free, low, high)"},
        {"low": f32(-3).reshape(()), "high": f32(4.5).reshape(())},
        "GB070",
        "camera-to-world",
    ),
    "linear": (
        {"colors": f"positive = Max (last, zero) powers = Pow (positive, gamma) {_COLORS.format('powers')}"},
        {"gamma": f32(2.2)},
        "GB071",
        "linear",
    ),
    "column by column": (
        {
            "colors": "by_column = Transpose <perm = [0, 3, 2, 1]> (image) "
            f"{_COLORS.format('by_column')}"
        },
        {},
        "GB071",
        "column by column",
    ),
    "corners of pixels": (
        {"rays": "half = Div (halves, focal) corners = Sub (slopes, half) "
                 "rays = Concat <axis = 2> (corners, ahead)"},
        {"halves": np.full((1, 1, 2), 0.5, np.float32)},
        "GB071",
        "half a pixel",
    ),
    "the first camera for all": (
        {"views": "views = Gather <axis = 0> (poses, first)"},
        {"first": i64(0, 0)},
        "GB071",
        "camera of picture 1",
    ),
}  # fmt: skip


def findings(model: ModelSpec, folder: Path) -> list[tuple[str, str]]:
    path = folder / "m.onnx"
    model.write(path)
    return [(finding.rule, finding.message) for finding in validate(path).findings]


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_pictures_and_cameras_is_noticed(name: str, tmp_path: Path) -> None:
    nodes, weights, rule, words = FAULTS[name]
    first, *_ = findings(pixel_model(**nodes).with_weights(**weights), tmp_path)
    assert first[0] == rule
    assert words in first[1]


def test_clamped_rows_are_not_asked_to_follow(tmp_path: Path) -> None:
    """Rows at the ends of the bounds stay, whichever way the cameras are read."""
    nodes = "free = MatMul (offsets, rotations) centers = Clip (free, low, high)"
    model = pixel_model(centers=nodes).with_weights(
        low=f32(-0.8).reshape(()), high=f32(0.8).reshape(())
    )
    assert not [entry for entry in findings(model, tmp_path) if entry[0] in ("GB070", "GB071")]


def test_a_template_that_samples_pictures_by_their_cameras_passes(tmp_path: Path) -> None:
    """Its rows stay where they are: only colours change with the cameras."""
    nodes = (
        "away = Mul (offsets, zero) shift = ReduceMean (offsets) small = Mul (shift, tint) "
        "ahead_of = Add (template, away) centers = Mul (ahead_of, one)"
    )
    model = pixel_model(
        centers=nodes, colors="plain = Reshape (last, color_shape) colors = Add (plain, small)"
    ).with_weights(
        template=np.random.default_rng(1).uniform(-1, 1, (2, 48, 3)).astype(np.float32),
        tint=f32(0.01),
    )
    assert not [entry for entry in findings(model, tmp_path) if entry[0] in ("GB070", "GB071")]


@pytest.mark.parametrize("name", ["by column", "last picture first"])
def test_rows_come_in_any_order(name: str, tmp_path: Path) -> None:
    """Without lenses, nobody knows which pixel a row shows."""
    numbers = np.arange(96).reshape(2, 6, 8)
    orders = {"by column": numbers.transpose(0, 2, 1), "last picture first": numbers[::-1]}
    model = pixel_model(
        colors="flat = Reshape (last, color_shape) colors = Gather <axis = 0> (flat, order)"
    )
    assert isinstance(model.manifest, GeneratorManifest)
    image, poses, lenses = model.manifest.inputs
    matrices = np.array(lenses.default, np.float32).reshape(2, 3, 3)
    model = (
        model.replace_text(
            "position = Reshape (centers, position_shape)",
            "places = Reshape (centers, position_shape) position = Gather <axis = 0> (places, order)",
        )
        .with_manifest(inputs=(image, poses))
        .with_weights(lenses=matrices, order=i64(*orders[name].reshape(-1)))
    )
    model = replace(model, inputs=model.inputs.replace(", float[2,3,3] lenses", ""))
    assert findings(model, tmp_path) == []

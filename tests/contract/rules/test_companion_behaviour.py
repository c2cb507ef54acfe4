"""Post-process models and predictors are judged by what they do with pictures and steady paths."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.arrays import f32, i64
from gsgen.conformance.fixtures.builders.images import darken, enlarge
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.conformance.fixtures.valid.companions import trajectory
from gsgen.contract.validator import validate

_NETWORK = "out = Mul (image, amount)"
_ANY = "height,width"
_LINEAR = "future = Concat <axis = 1> (place, unit)"


def findings(model: ModelSpec, folder: Path) -> set[str]:
    """Validate a model; return the rules that report something."""
    path = folder / "m.onnx"
    model.write(path)
    return {finding.rule for finding in validate(path).findings}


def sharpened(size: str, nodes: str) -> ModelSpec:
    """Return a model that sharpens a picture before or after some nodes from ``image`` to ``out``."""
    kernel = np.zeros((3, 1, 3, 3), np.float32)
    kernel[:, 0, 1] = kernel[:, 0, :, 1] = -0.1
    kernel[:, 0, 1, 1] = 1.4
    body = (
        "sharp = Conv <group = 3, pads = [1, 1, 1, 1]> (changed, kernel) "
        "out = Clip (sharp, zero, one)"
    )
    model = darken(size).replace_text(_NETWORK, f"{nodes.replace('out =', 'changed =')} {body}")
    return model.with_weights(
        kernel=kernel, last=i64(-1), before_first=i64(-(10**6)), rows=i64(2), columns=i64(3),
        both=i64(2, 3), lasts=i64(-1, -1), before_firsts=i64(-(10**6), -(10**6)),
        bgr=i64(2, 1, 0), gbr=i64(1, 2, 0), byte=f32(1 / 255), last_shape=i64(1, 8, 12, 3),
        fill=i64(0, 0, 5, 3, 0, 0, 0, 0), zero=np.array(0, np.float32), one=np.array(1, np.float32), channel=i64(1), corner=i64(0, 0), sixteen=i64(16),
        gamma=f32(2.2), means=np.array([0.485, 0.456, 0.406], np.float32).reshape(1, 3, 1, 1),
        vignette=np.cos(np.linspace(-1, 1, 32)).astype(np.float32),
        stripes=np.where(np.arange(32) % 16 < 8, 1, 0.8).astype(np.float32),
        spatial=i64(2), four=i64(4), none=i64(0, 0, 0, 0), halves=i64(2, 2),
    )  # fmt: skip


@pytest.mark.parametrize("middle", [1.0, 4.0])
def test_filters_that_sharpen_are_not_refused(middle: float, tmp_path: Path) -> None:
    """At noise their results leave the range, which a runtime clips; pictures stay within."""
    kernel = np.full((3, 1, 3, 3), -middle / 8, np.float32)
    kernel[:, 0, 1, 1] += 1 + middle + middle / 8
    conv = "out = Conv <group = 3, pads = [1, 1, 1, 1]> (image, amount)"
    model = darken("32,32").replace_text(_NETWORK, conv).with_weights(amount=kernel)
    model.write(tmp_path / "m.onnx")
    assert validate(tmp_path / "m.onnx").verdict == "conforms"


_PADDED = (
    "shape = Shape (image) size = Slice (shape, spatial, four) "
    "over = Mod (size, sixteen) rest = Sub (sixteen, over) half = Div (rest, halves) "
    "starts = Concat <axis = 0> (corner, half) widths = Concat <axis = 0> (starts, starts) "
    'padded = Pad <mode = "edge"> (image, widths) '
)
# Picture faults: the size, the nodes, and the rule that notices.
PICTURE_FAULTS = {
    "upside down": ("8,12", "out = Slice (image, last, before_first, rows, last)", "GB063"),
    "mirrored": ("8,12", "out = Slice (image, last, before_first, columns, last)", "GB063"),
    "half a turn": ("8,12", "out = Slice (image, lasts, before_firsts, both, lasts)", "GB063"),
    "blue first": (_ANY, "out = Gather <axis = 1> (image, bgr)", "GB063"),
    "green first": (_ANY, "out = Gather <axis = 1> (image, gbr)", "GB063"),
    "channels written last": (
        "8,12",
        "shape = Shape (image) turned = Transpose <perm = [0, 2, 3, 1]> (image) "
        "out = Reshape (turned, shape)",
        "GB063",
    ),
    "channels read last": (
        "8,12",
        "rows_first = Reshape (image, last_shape) "
        "out = Transpose <perm = [0, 3, 1, 2]> (rows_first)",
        "GB063",
    ),
    "height and width exchanged": (
        "8,12",
        "shape = Shape (image) turned = Transpose <perm = [0, 1, 3, 2]> (image) "
        "out = Reshape (turned, shape)",
        "GB063",
    ),
    "padded at the left": (
        _ANY,
        "shape = Shape (image) size = Slice (shape, spatial, four) "
        "padded = Pad (image, fill, zero) out = Slice (padded, corner, size, both)",
        "GB063",
    ),
    "padded on both sides, cropped on one": (
        _ANY,
        f"{_PADDED} out = Slice (padded, corner, size, both)",
        "GB063",
    ),
    "moved by two pixels": (
        "24,32",
        "shape = Shape (image) size = Slice (shape, spatial, four) "
        "padded = Pad (image, fill, zero) out = Slice (padded, corner, size, both)",
        "GB063",
    ),
    "linear numbers": (_ANY, "out = Pow (image, gamma)", "GB072"),
    "means not added back": (
        _ANY,
        "left = Sub (image, means) out = Clip (left, zero, one)",
        "GB072",
    ),
    "stripes": ("24,32", "out = Mul (image, stripes)", "GB072"),
    "bytes expected": ("8,12", "out = Mul (image, byte)", "GB064"),
    "bytes expected at any size": (_ANY, "out = Mul (image, byte)", "GB064"),
}
RIGHT_PICTURES = {
    "a vignette": ("24,32", "out = Mul (image, vignette)"),
    "sharpened": ("8,12", "out = Identity (image)"),
    "sharpened at any size": (_ANY, "out = Identity (image)"),
    "inverted": (_ANY, "out = Sub (one, image)"),
    "grey": (
        _ANY,
        "shape = Shape (image) grey = ReduceMean <keepdims = 1> (image, channel) "
        "out = Expand (grey, shape)",
    ),
    "padded and cropped": (
        _ANY,
        f"{_PADDED} ends = Add (half, size) out = Slice (padded, half, ends, both)",
    ),
}


@pytest.mark.parametrize("name", PICTURE_FAULTS)
def test_a_fault_of_pictures_is_noticed(name: str, tmp_path: Path) -> None:
    size, nodes, rule = PICTURE_FAULTS[name]
    assert findings(sharpened(size, nodes), tmp_path) == {rule}


@pytest.mark.parametrize("name", RIGHT_PICTURES)
def test_right_pictures_pass(name: str, tmp_path: Path) -> None:
    size, nodes = RIGHT_PICTURES[name]
    assert not findings(sharpened(size, nodes), tmp_path)


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_networks_with_random_weights_pass(seed: int, tmp_path: Path) -> None:
    random = np.random.default_rng(seed)
    weights = {
        "into": random.normal(0, 0.3, (16, 3, 3, 3)),
        "back": random.normal(0, 0.1, (3, 16, 3, 3)),
    }
    nodes = (
        "wide = Conv <pads = [1, 1, 1, 1]> (image, into) bent = Relu (wide) "
        "narrow = Conv <pads = [1, 1, 1, 1]> (bent, back) out = Sigmoid (narrow)"
    )
    numbers = {name: array.astype(np.float32) for name, array in weights.items()}
    assert not findings(
        darken(_ANY).replace_text(_NETWORK, nodes).with_weights(**numbers), tmp_path
    )


def test_a_product_with_alpha_is_noticed(tmp_path: Path) -> None:
    model = darken().replace_text("float[1,3,8,12] image", "float[1,4,8,12] image")
    nodes = "colors = Slice (image, first, last, axis) {}"
    numbers = {"first": i64(0), "last": i64(3), "end": i64(4), "axis": i64(1)}
    times = "alpha = Slice (image, last, end, axis) out = Mul (colors, alpha)"
    for rest, expected in ((times, {"GB072"}), ("out = Mul (colors, amount)", set())):
        changed = model.replace_text(_NETWORK, nodes.format(rest)).with_weights(**numbers)
        assert findings(changed, tmp_path) == expected


def test_an_enlarged_picture_upside_down_is_noticed(tmp_path: Path) -> None:
    model = enlarge(_ANY, "twice_height,twice_width")
    flip = "turned = Slice (image, last, before_first, rows, last) dark = Mul (turned, amount)"
    flipped = model.replace_text("dark = Mul (image, amount)", flip)
    numbers = {"last": i64(-1), "before_first": i64(-(10**6)), "rows": i64(2)}
    assert findings(flipped.with_weights(**numbers), tmp_path) == {"GB063"}


def weights_of_states(*rows: tuple[float, ...]) -> np.ndarray:
    """Return weights of four past states for each of three predictions, oldest state first."""
    return np.array(rows, np.float32)


def from_speed(factor: float) -> np.ndarray:
    """Return the weights of s₃ + k · factor · (s₃ − s₂) for k from 1 to 3."""
    return weights_of_states(*[(0.0, 0.0, -factor * k, 1 + factor * k) for k in (1, 2, 3)])


def predictor(
    positions: np.ndarray, rotations: np.ndarray, axes: np.ndarray | None = None
) -> ModelSpec:
    """Return a predictor whose states are weighted sums of past ones.

    Args:
        positions: Weights of past positions, [3, 4].
        rotations: Weights of past quaternions, [3, 4].
        axes: A matrix that the speed is multiplied by, [3, 3].
    """
    speeds = positions - np.eye(4)[[3, 3, 3]]
    nodes = (
        "newest = MatMul (last_state, past) here, unused = Split <axis = 1> (newest, widths) "
        "motion = MatMul (speeds, past) shift, idle = Split <axis = 1> (motion, widths) "
        f"turned = MatMul (shift, axes) at = Add (here, turned) {_LINEAR.replace('place', 'at')}"
    )
    return trajectory.draw().replace_text(_LINEAR, nodes).with_weights(
        steps=rotations.astype(np.float32),
        last_state=np.eye(4, dtype=np.float32)[[3, 3, 3]],
        speeds=speeds.astype(np.float32),
        axes=(np.eye(3) if axes is None else axes).astype(np.float32),
    )  # fmt: skip


ON = from_speed(1.0)
PATH_FAULTS = {
    "history read backwards": predictor(ON[:, ::-1], ON[:, ::-1]),
    "predictions written backwards": predictor(ON[::-1], ON[::-1]),
    "predictions in another order": predictor(ON[[0, 2, 1]], ON[[0, 2, 1]]),
    "speed negated": predictor(from_speed(-1.0), ON),
    "a fifth of the speed, negated": predictor(from_speed(-0.2), ON),
    "starts at the oldest state": predictor(
        weights_of_states(*[(1.0, 0.0, -k, k) for k in (1, 2, 3)]), ON
    ),
    "speed per second": predictor(from_speed(10.0), ON),
    "axes y and z exchanged": predictor(ON, ON, np.eye(3)[[0, 2, 1]]),
    "axis y negated": predictor(ON, ON, np.diag([1.0, -1.0, 1.0])),
    "axes in the order y z x": predictor(ON, ON, np.eye(3)[[1, 2, 0]]),
    "axis y damped": predictor(ON, ON, np.diag([1.0, 0.4, 1.0])),
    "speed per step times seconds": predictor(from_speed(0.1), ON),
    "turn negated": predictor(ON, from_speed(-1.0)),
    "half the speed": predictor(from_speed(0.5), ON),
    "half the turn": predictor(ON, from_speed(0.5)),
    "stays": predictor(from_speed(0.0), from_speed(0.0)),
    "two steps at once": predictor(from_speed(2.0), ON),
    "rotations read backwards": predictor(ON, ON[:, ::-1]),
}
RIGHT_PATHS = {
    "goes on": predictor(ON, ON),
    "slows down a little": predictor(from_speed(0.9), from_speed(0.9)),
    "mean speed": predictor(
        weights_of_states(*[(-k / 3, 0.0, 0.0, 1 + k / 3) for k in (1, 2, 3)]), ON
    ),
    "constant acceleration": predictor(
        weights_of_states((0.0, 1.0, -3.0, 3.0), (0.0, 3.0, -8.0, 6.0), (0.0, 6.0, -15.0, 10.0)), ON
    ),
    "the vertical damped": predictor(ON, ON, np.diag([1.0, 0.4, 1.0])).edit_manifest(
        lambda fields: fields.update(space={"up": "+y"})
    ),
    "speed mixed a little": predictor(
        from_speed(0.95), ON, np.eye(3) + np.random.default_rng(2).normal(0, 0.05, (3, 3))
    ),
}


@pytest.mark.parametrize("name", PATH_FAULTS)
def test_a_fault_of_paths_is_noticed(name: str, tmp_path: Path) -> None:
    assert "GB062" in findings(PATH_FAULTS[name], tmp_path)


@pytest.mark.parametrize("span", [(5.0, 5.0), (2.0**20, 2.0**20 + 1)])
def test_steps_that_float32_does_not_tell_are_not_judged(
    span: tuple[float, float], tmp_path: Path
) -> None:
    model = predictor(ON, ON).edit_manifest(lambda fields: fields["inputs"][0].update(range=span))
    assert "GB062" not in findings(model, tmp_path)


@pytest.mark.parametrize("name", RIGHT_PATHS)
def test_right_predictors_pass(name: str, tmp_path: Path) -> None:
    assert not findings(RIGHT_PATHS[name], tmp_path)

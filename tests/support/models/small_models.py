"""Small models, written as ONNX text, for tests of the contract."""

from pathlib import Path

import numpy as np
from onnx import ModelProto, TensorProto, numpy_helper, parser

from gsgen.contract.model.model_file import write_manifest
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Input,
    Manifest,
    Space,
)

HEAD = '<ir_version: 10, opset_import: ["" : 18]>\n'
_MOVING_MODEL_TEXT = """
moving (float[1] time) => (float[ROWS,10] gaussians, float[ROWS,3] color, int32[1] num_points)
<float[1,10] step = {0.001, 0, 0, 0, 0, 0, 0, 0, 0, 0}, float still = {0}> {
    offset = Mul (time, step)
    gaussians = Add (rows, offset)
    nothing = Mul (time, still)
    color = Add (colors, nothing)
    num_points = Identity (live)
}
"""


def model(text: str, *weights: TensorProto) -> ModelProto:
    """Parse ONNX text, and add weights that text cannot hold."""
    proto = parser.parse_model(HEAD + text)
    proto.graph.initializer.extend(weights)
    return proto


def weight(name: str, array: np.ndarray) -> TensorProto:
    return numpy_helper.from_array(array, name)


def good_rows(count: int) -> np.ndarray:
    """Rows that break no rule: small round Gaussians in the unit cube."""
    rows = np.zeros((count, 10), np.float32)
    rows[:, :3] = np.random.default_rng(count).uniform(-0.9, 0.9, (count, 3))
    rows[:, 3] = 0.5
    rows[:, [4, 7, 9]] = 0.01
    return rows


def moving(rows: np.ndarray, live: int | None = None) -> ModelProto:
    """A generator whose first column is ``rows[:, 0] + time / 1000``."""
    count = np.array([len(rows) if live is None else live], np.int32)
    colors = np.full((len(rows), 3), 0.5, np.float32)
    text = _MOVING_MODEL_TEXT.replace("ROWS", str(len(rows)))
    named = {"rows": rows, "colors": colors, "live": count}
    return model(text, *(weight(name, array) for name, array in named.items()))


def manifest_of(capacity: int) -> GeneratorManifest:
    """The manifest of a :func:`moving` model."""
    outputs = GeneratorOutputs(
        GaussiansOutput("gaussians", capacity),
        AppearanceOutput("color", "rgb"),
        CountOutput("num_points"),
    )
    return GeneratorManifest(
        name="moving",
        inputs=(Input(name="time", role="time", range=(0.0, 1.0)),),
        outputs=outputs,
        space=Space(),
        bounds=Bounds((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
    )


def save(path: Path, proto: ModelProto, manifest: Manifest | None = None) -> Path:
    """Write a model, with its manifest where one is given."""
    path.write_bytes(proto.SerializeToString())
    if manifest is not None:
        write_manifest(path, manifest, path)
    return path


def save_moving(path: Path, rows: np.ndarray, live: int | None = None) -> Path:
    """Write a :func:`moving` model with its manifest."""
    return save(path, moving(rows, live), manifest_of(len(rows)))

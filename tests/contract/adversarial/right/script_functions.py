"""Right models written as onnxscript functions."""

from functools import partial

import numpy as np
import onnx
from onnx import numpy_helper
from onnxscript import FLOAT, INT32, script
from onnxscript import opset18 as op

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import declare
from contract.adversarial.graph_builder import value_info
from contract.adversarial.scenes import rows, scene, sh_columns

TOOL = "onnxscript"


@script(default_opset=op)
def breathing(
    t: FLOAT[1], table: FLOAT[64, 10], harmonics: FLOAT[64, 27], live: INT32[1], lift: FLOAT[10]
):
    phase = op.Sin(t * 3.14159274)
    gaussians = table + phase * lift
    color = harmonics * 1.0
    num_points = op.Identity(live)
    return gaussians, color, num_points


@script(default_opset=op)
def dimmed(
    t: FLOAT[1], table: FLOAT[64, 10], harmonics: FLOAT[64, 27], live: INT32[1], lift: FLOAT[10]
):
    clip = op.Clip(1.0 - 0.5 * t, 0.2, 1.0)
    gaussians = table + 0.0 * lift
    color = harmonics * clip
    num_points = op.Identity(live)
    return gaussians, color, num_points


def _scripted(function: object, kind: str, statistics: str) -> Draft:
    source = scene(kind, statistics, seed=90)
    model = function.to_model_proto()  # type: ignore[attr-defined]
    model.ir_version = 9
    lift = np.zeros(10)
    lift[2] = 0.1
    weights = {
        "table": rows(source).astype(np.float32),
        "harmonics": sh_columns(source, 2).astype(np.float32),
        "live": np.array([64], np.int32),
        "lift": lift.astype(np.float32),
    }
    inputs = [info for info in model.graph.input if info.name == "t"]
    del model.graph.input[:]
    model.graph.input.extend(inputs)
    for name, array in weights.items():
        model.graph.initializer.append(numpy_helper.from_array(array, name))
    del model.graph.output[:]
    shapes = {"gaussians": [64, 10], "color": [64, 27], "num_points": [1]}
    for name, shape in shapes.items():
        dtype = "int32" if name == "num_points" else "float32"
        model.graph.output.append(value_info(name, shape, dtype))
    proto = onnx.ModelProto()
    proto.CopyFrom(model)
    entry = {"name": "t", "role": "time", "range": [0, 1], "default": 0}
    low, high = source.position.min(0), source.position.max(0) + np.array([0, 0, 0.1])
    return Draft(proto, declare(64, low, high, degree=2, inputs=[entry]))


for function in (breathing, dimmed):
    for kind, statistics in (("surface", "trained"), ("cloud", "trained"), ("avatar", "synthetic")):
        right_model(
            f"script_{function.name}_{kind}",
            TOOL,
            kind,
            statistics,
            build=partial(_scripted, function, kind, statistics),
        )

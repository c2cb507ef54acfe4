"""Right models built with onnx_ir, and models that its passes went over."""

from functools import partial

import numpy as np
import onnx_ir as ir
import onnx_ir.passes.common as common

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import declare
from contract.adversarial.scenes import rows, scene, sh_columns

TOOL = "onnx_ir"


def _tape(kind: str, statistics: str, dtype: str) -> Draft:
    """A model whose brightness is a slider, built on a tape."""
    source = scene(kind, statistics, seed=85)
    half = ir.DataType.FLOAT16 if dtype == "float16" else ir.DataType.FLOAT
    tape = ir.tape.Tape()
    sun = ir.val("sun", dtype=ir.DataType.FLOAT, shape=[1])
    table, harmonics = (
        tape.initializer(ir.tensor(array.astype(dtype), name=name))
        for name, array in (("table", rows(source)), ("harmonics", sh_columns(source, 1)))
    )
    live = tape.initializer(ir.tensor(np.array([source.count], np.int32), name="live"))
    brightness_node = tape.op("Cast", [sun], {"to": int(half)})
    outputs = [
        tape.op("Identity", [table], output=_value("gaussians", half, source.count, 10)),
        tape.op(
            "Mul", [harmonics, brightness_node], output=_value("color", half, source.count, 12)
        ),
        tape.op("Identity", [live], output=_value("num_points", ir.DataType.INT32, 1)),
    ]
    graph = ir.Graph(
        [sun],
        outputs,
        nodes=tape.nodes,
        initializers=tape.initializers,
        opset_imports={"": 20},
        name="scene",
    )
    model = ir.Model(graph, ir_version=10)
    common.NameFixPass()(model)
    stored = source.position.astype(dtype).astype(float)
    slider = {"name": "sun", "role": "control", "shape": [1], "range": [0.5, 1.2], "default": 1.0}
    manifest = declare(
        source.count, stored.min(0), stored.max(0), degree=1, dtype=dtype, inputs=[slider]
    )
    return Draft(ir.to_proto(model), manifest)


def _value(name: str, dtype: ir.DataType, *shape: int) -> ir.Value:
    return ir.Value(name=name, shape=ir.Shape(shape), type=ir.TensorType(dtype))


for kind in ("surface", "hair", "cloud", "room", "avatar"):
    statistics = "synthetic" if kind in ("cloud", "hair") else "trained"
    for dtype in ("float32", "float16") if kind in ("surface", "room") else ("float32",):
        right_model(
            f"tape_{kind}_{dtype}",
            TOOL,
            kind,
            statistics,
            build=partial(_tape, kind, statistics, dtype),
        )

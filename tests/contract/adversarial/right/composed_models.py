"""Right models that ``onnx.compose`` and ``onnx.version_converter`` made of others."""

from functools import partial

import numpy as np
import onnx
import onnx.compose
import onnx.shape_inference
import onnx.version_converter

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import declare, static
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import rows, scene, sh_columns

TOOL = "onnx.compose and version_converter"


def _joined(kind: str) -> Draft:
    """A table of rows in one model, their motion in another."""
    source = scene(kind, seed=98)
    first, second = GraphBuilder(), GraphBuilder()
    first.output(
        "rest", first.op("Mul", first.constant(rows(source)), first.constant(1.0)), [64, 10]
    )
    rest_rows, time = second.input("rows", [64, 10]), second.input("time", [1])
    opacity_offset = np.zeros(10)
    opacity_offset[0] = 0.25
    moved = second.op("Add", rest_rows, second.op("Mul", time, second.constant(opacity_offset)))
    second.output("gaussians", moved, [64, 10])
    second.output("color", second.constant(sh_columns(source, 3)), [64, 48])
    second.output("num_points", second.constant([64], "int32"), [1], "int32")
    renamed = onnx.compose.add_prefix(first.proto, "table/")
    joined = onnx.compose.merge_models(renamed, second.proto, io_map=[("table/rest", "rows")])
    entry = {"name": "time", "role": "time", "range": [0, 1], "default": 0}
    low, high = source.position.min(0), source.position.max(0) + np.array([0.25, 0, 0])
    return Draft(joined, declare(64, low, high, inputs=[entry]))


def _converted(kind: str, opset: int) -> Draft:
    draft = static(scene(kind, seed=99), degree=2)
    converted = onnx.version_converter.convert_version(draft.proto, opset)
    converted.ir_version = 8 if opset < 19 else 10
    return Draft(converted, draft.manifest)


def _inferred(kind: str) -> Draft:
    draft = _joined(kind)
    return Draft(onnx.shape_inference.infer_shapes(draft.proto), draft.manifest)


for kind in ("surface", "hair", "cloud"):
    right_model(f"merged_{kind}", TOOL, kind, "trained", build=partial(_joined, kind))
for kind, opset in (("room", 16), ("avatar", 17), ("surface", 21)):
    right_model(
        f"converted_to_{opset}_{kind}",
        TOOL,
        kind,
        "trained",
        build=partial(_converted, kind, opset),
    )
right_model("inferred_room", TOOL, "room", "trained", build=partial(_inferred, "room"))

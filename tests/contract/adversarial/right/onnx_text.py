"""Right models written as ONNX text, with their weights filled in."""

from functools import partial

import numpy as np
import onnx.parser
from onnx import numpy_helper

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import declare
from contract.adversarial.scenes import rows, scene, sh_columns

TOOL = "onnx.parser"

STATIC = """
<ir_version: 10, opset_import: ["" : 21]>
scene () => (float[64,10] gaussians, float[64,12] color, int32[1] num_points)
<float[64,10] table, float[64,12] harmonics>
{
   gaussians = Identity(table)
   color = Identity(harmonics)
   num_points = Constant<value = int32[1] {64}>()
}
"""

FADING = """
<ir_version: 8, opset_import: ["" : 17]>
scene (float[1] fade) => (float[64,10] gaussians, float[64,12] color, int32[1] num_points)
<float[64,10] table, float[64,12] harmonics, float[10] opacity_column, float one = {1}>
{
   thinner = Mul(fade, opacity_column)
   factor = Sub(one, thinner)
   gaussians = Mul(table, factor)
   color = Identity(harmonics)
   num_points = Constant<value = int32[1] {64}>()
}
"""

FUNCTION = """
<ir_version: 10, opset_import: ["" : 18, "local" : 1]>
scene (float[1] t) => (float[64,10] gaussians, float[64,12] color, int32[1] num_points)
<float[64,10] table, float[64,12] harmonics, float[10] lift>
{
   gaussians = local.Shift(table, t, lift)
   color = Identity(harmonics)
   num_points = Constant<value = int32[1] {64}>()
}
<domain: "local", opset_import: ["" : 18]>
Shift (table, t, lift) => (moved)
{
   by = Mul(t, lift)
   moved = Add(table, by)
}
"""

TIME = {"name": "t", "role": "time", "range": [0, 1], "default": 0}
FADE = {"name": "fade", "role": "control", "shape": [1], "range": [0, 0.5], "default": 0}


def _text(text: str, kind: str, statistics: str) -> Draft:
    source = scene(kind, statistics, seed=80)
    model = onnx.parser.parse_model(text)
    column, opacity_offset = np.zeros(10), np.zeros(10)
    column[3], opacity_offset[1] = 1, 0.2
    values = {
        "table": rows(source),
        "harmonics": sh_columns(source, 1),
        "opacity_column": column,
        "lift": opacity_offset,
    }
    graph = model.graph
    weights = {tensor.name for tensor in graph.initializer}
    for info in [*graph.value_info, *graph.input]:
        if info.name in values and info.name not in weights:
            array = values[info.name].astype(np.float32)
            graph.initializer.append(numpy_helper.from_array(array, info.name))
    retained = [info for info in graph.value_info if info.name not in values]
    del graph.value_info[:]
    graph.value_info.extend(retained)
    for index, tensor in reversed(list(enumerate(graph.initializer))):
        if tensor.name in values and not (tensor.raw_data or tensor.float_data):
            del graph.initializer[index]
    low, high = source.position.min(0), source.position.max(0)
    inputs = []
    if text is FUNCTION:
        inputs, high = [TIME], high + np.array([0, 0.2, 0])
    if text is FADING:
        inputs = [FADE]
    return Draft(model, declare(64, low, high, degree=1, inputs=inputs))


for name, text in (("static", STATIC), ("fading", FADING), ("function", FUNCTION)):
    for kind, statistics in (("surface", "trained"), ("hair", "synthetic"), ("room", "trained")):
        right_model(
            f"text_{name}_{kind}",
            TOOL,
            kind,
            statistics,
            build=partial(_text, text, kind, statistics),
        )

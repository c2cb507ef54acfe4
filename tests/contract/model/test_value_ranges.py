import math
from dataclasses import replace

import pytest

from gsgen.contract.model.graph import read_graph
from gsgen.contract.model.model_file import open_model
from gsgen.contract.model.value_ranges import intervals
from gsgen.contract.spec.manifest import Input
from support.models.small_models import manifest_of, model, save

TIME = replace(manifest_of(1), inputs=(Input(name="x", role="time", range=(-2.0, 3.0)),))

SPANS = {
    "y = Identity (x)": (-2, 3),
    "y = Neg (x)": (-3, 2),
    "y = Abs (x)": (0, 3),
    "y = Relu (x)": (0, 3),
    "y = Add (x, two)": (0, 5),
    "y = Sub (two, x)": (-1, 4),
    "y = Mul (x, x)": (-6, 9),
    "y = Div (x, two)": (-1, 1.5),
    "y = Div (two, x)": (-math.inf, math.inf),
    "y = Max (x, two)": (2, 3),
    "y = Clip (x, zero, two)": (0, 2),
    "h = Div (x, two) y = Floor (h)": (-1, 1),
    "h = Div (x, two) y = Round (h)": (-1, 2),
    "y = Concat <axis = 0> (x, two)": (-2, 3),
    "y = Sigmoid (x)": (0, 1),
    "e = Exp (x) y = Tanh (e)": (-1, 1),
    "y = ReduceSum <keepdims = 1> (x)": (-2, 3),
    "t = Concat <axis = 0> (x, x, two) y = ReduceSum <keepdims = 1> (t)": (-6, 9),
    "b = Cast <to = 9> (two) c = Cast <to = 1> (b) y = Add (c, x)": (-2, 4),
    "e = Exp (x) b = Less (e, two) y = Cast <to = 1> (b)": (0, 1),
    "y = Sign (x)": (-1, 1),
    "y = Mod <fmod = 1> (x, two)": (-2, 2),
    "y = Exp (x)": None,
    "e = Exp (x) y = Add (e, two)": None,
    "e = Exp (x) y = Cast <to = 6> (e)": (-(2**31), 2**31 - 1),
}


@pytest.mark.parametrize("body", SPANS)
def test_an_interval_holds_all_that_can_come_out(tmp_path, body):
    kind = "int32" if "to = 6" in body else "float"
    text = (
        f"m (float[1] x) => ({kind}[N] y) <float[1] two = {{2}}, float zero = {{0}}> "
        f"{{ {body.replace('zero, two', 'zero, top')} }}"
    ).replace("float zero = {0}", "float zero = {0}, float top = {2}")
    file = open_model(save(tmp_path / "m.onnx", model(text)))
    spans = intervals(read_graph(file), file.proto.graph.initializer, TIME)
    assert spans.get("y") == SPANS[body]

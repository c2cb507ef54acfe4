import numpy as np
import pytest

from gsgen.contract.model.graph import read_graph
from gsgen.contract.model.model_file import open_model
from gsgen.contract.model.provider_placement import frame_nodes, placements
from gsgen.contract.spec.operator_tables import operator_table
from support.models.small_models import model, save, weight

NATIVE = operator_table("ep-webgpu-0.4.0")
JSEP = operator_table("onnxruntime-web-1.22.0")


@pytest.fixture
def opened(tmp_path):
    def read(text, *weights):
        file = open_model(save(tmp_path / "m.onnx", model(text, *weights)))
        return read_graph(file), file.proto

    return read


def test_only_what_depends_on_inputs_and_is_needed_runs_every_frame(opened):
    graph, _ = opened("""
    m (float[2] x) => (float[2] y) <float[2] w = {1, 2}> {
        fixed = Neg (w)
        used = Add (x, fixed)
        size = Shape (used)
        unused = Abs (used)
        y = Reshape (used, size)
    }
    """)
    assert [node.output[0] for node in frame_nodes(graph)] == ["used", "y"]


def test_a_draw_runs_every_frame_though_nothing_feeds_it(opened):
    graph, _ = opened("m () => (float[2] y) { d = RandomNormal <shape = [2]> () y = Neg (d) }")
    assert [node.output[0] for node in frame_nodes(graph)] == ["d", "y"]


CAUSES = {
    "y = Neg (x)": "",
    "y = Round (x)": "operator",
    "y = Sum (x, x)": "unknown",
    "y = LpNormalization (x)": "",
    "i = Cast <to = 7> (x) n = Neg (i) y = Cast <to = 1> (n)": "int64",
    "y = Pow (x, one)": "int64",
    "y = Pow (x, x)": "",
    "d = Cast <to = 11> (x) n = Neg (d) y = Cast <to = 1> (n)": "float64",
    "n = NonZero (x) f = Cast <to = 1> (n) y = ReduceSum <keepdims = 0> (f, one)": "shape",
    "i = Cast <to = 7> (x) y = Expand (x, i)": "shape",
}


@pytest.mark.parametrize("body", CAUSES)
def test_a_node_that_is_not_captured_has_one_cause(opened, body):
    text = f"m (float[1] x) => (float[1] y) <int64[1] one = {{1}}> {{ {body} }}"
    causes = {placement.cause for placement in placements(*opened(text), (NATIVE,))} - {""}
    assert causes == ({CAUSES[body]} if CAUSES[body] else set())


def test_finding_names_the_affected_releases(opened):
    actual = placements(
        *opened("m (float[2] x) => (float[2] y) { y = Max (x, x) }"), (NATIVE, JSEP)
    )
    assert [(entry.cause, entry.outcomes) for entry in actual] == [
        ("operator", {"onnxruntime-web 1.22.0 (JSEP)": "cpu"})
    ]


@pytest.mark.parametrize(("step", "cause"), [(1, ""), (-1, "operator")])
def test_a_step_backwards_is_seen_in_the_weight(opened, step, cause):
    text = "m (float[4] x) => (float[N] y) { y = Slice (x, from, to, axis, step) }"
    numbers = {"from": 0, "to": 4, "axis": 0, "step": step}
    weights = [weight(name, np.asarray([n])) for name, n in numbers.items()]
    (placement,) = placements(*opened(text, *weights), (JSEP,))
    assert placement.cause == cause

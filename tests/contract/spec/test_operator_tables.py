import re

import pytest

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.operator_tables import FAILED_OUTCOMES, GRAPH_CAPTURE, operator_table
from gsgen.contract.spec.targets import known_targets

NAMES = ("ep-webgpu-0.4.0", "onnxruntime-web-1.30.0", "onnxruntime-web-1.22.0")


@pytest.mark.parametrize("name", NAMES)
def test_every_outcome_of_a_table_has_words(name):
    table = operator_table(name)
    assert re.search(r"\d+\.\d+", table.runtime)
    actual = {outcome for steps in table.outcomes.values() for outcome in steps.values()}
    assert actual <= {GRAPH_CAPTURE, *FAILED_OUTCOMES}


@pytest.mark.parametrize(
    ("name", "operator", "variant", "dtype", "opset", "outcome"),
    [
        ("ep-webgpu-0.4.0", "Sin", "", "float32", 13, GRAPH_CAPTURE),
        ("ep-webgpu-0.4.0", "Sin", "", "float32", 21, GRAPH_CAPTURE),
        ("ep-webgpu-0.4.0", "Sin", "", "float32", 22, "cpu"),
        ("ep-webgpu-0.4.0", "Sin", "", "float32", 26, "cpu"),
        ("ep-webgpu-0.4.0", "Sin", "", "bfloat16", 18, ""),
        ("ep-webgpu-0.4.0", "Sum", "", "float32", 18, ""),
        ("ep-webgpu-0.4.0", "Slice", "backwards", "float32", 18, GRAPH_CAPTURE),
        ("onnxruntime-web-1.22.0", "Slice", "", "float32", 18, GRAPH_CAPTURE),
        ("onnxruntime-web-1.22.0", "Slice", "backwards", "float32", 18, "run_error"),
        ("onnxruntime-web-1.22.0", "MatMul", "", "float16", 18, GRAPH_CAPTURE),
        ("onnxruntime-web-1.22.0", "MatMul", "vector", "float16", 18, "run_error"),
        ("onnxruntime-web-1.22.0", "Conv", "implicit dilations", "float32", 18, "run_error"),
        ("onnxruntime-web-1.22.0", "Conv", "", "float32", 18, ""),
        ("onnxruntime-web-1.30.0", "Conv", "implicit dilations", "float32", 18, GRAPH_CAPTURE),
        ("onnxruntime-web-1.22.0", "Max", "", "float32", 18, "cpu"),
        ("onnxruntime-web-1.30.0", "Max", "", "float32", 18, GRAPH_CAPTURE),
    ],
)
def test_table_states_the_measured_outcome(name, operator, variant, dtype, opset, outcome):
    assert operator_table(name).outcome(operator, variant, dtype, opset) == outcome


def test_an_operator_set_with_a_kernel_is_named():
    table = operator_table("ep-webgpu-0.4.0")
    assert table.opset_with_kernel("Sin", "", "float32") == 17
    assert table.opset_with_kernel("Round", "", "float32") is None


def test_every_target_names_tables_that_exist():
    for target in known_targets().values():
        assert all(operator_table(name).outcomes for name in target.operators)


def test_an_unknown_table_names_the_nearest():
    with pytest.raises(UnknownName, match=r"'onnxruntime-web-1\.22\.0'"):
        operator_table("onnxruntime-web-1.22")

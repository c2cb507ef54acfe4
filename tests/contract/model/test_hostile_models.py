"""Models that once stopped the validator: each is judged, in time, and is no internal error."""

import json
import time

import numpy as np
import pytest
from onnx import parser

from gsgen.conformance.fixtures import find
from gsgen.contract.model.graph import read_graph
from gsgen.contract.model.model_file import open_model
from gsgen.contract.model.shape_inference import infer
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.models.small_models import model, save

STATIC = Settings(level=Level.STATIC)


def with_colors_at(path, **entries):
    """Write a model whose colours lie in another file, as ``entries`` say."""
    proto = find("external_data_missing").draw().build()
    (colors,) = (weight for weight in proto.graph.initializer if weight.name == "colors")
    del colors.external_data[:]
    for key, value in entries.items():
        colors.external_data.add(key=key, value=value)
    return save(path, proto)


def finding_of(path, rule):
    (finding,) = (finding for finding in validate(path, STATIC).findings if finding.rule == rule)
    return finding


@pytest.mark.parametrize("length", ["9" * 30, "9" * 5000])
def test_a_length_of_thousands_of_digits_is_more_than_any_file_has(tmp_path, length):
    (tmp_path / "colors.bin").write_bytes(bytes(60))
    path = with_colors_at(tmp_path / "a.onnx", location="colors.bin", length=length)
    message = finding_of(path, "GS001").message
    assert message.endswith("has 60 bytes (weight 'colors'); expected at least 9223372036854775807")


def test_a_name_that_no_file_can_have_is_a_finding(tmp_path):
    path = with_colors_at(tmp_path / "a.onnx", location="x" * 5000)
    assert "cannot be looked up: File name too long" in finding_of(path, "GS001").message


def test_links_in_a_circle_are_a_finding(tmp_path):
    (tmp_path / "a.bin").symlink_to("b.bin")
    (tmp_path / "b.bin").symlink_to("a.bin")
    path = with_colors_at(tmp_path / "a.onnx", location="a.bin")
    assert "cannot be looked up: " in finding_of(path, "GS001").message


def test_colours_without_channels_are_no_crash(tmp_path):
    spec = find("nan_row").draw()
    none = np.zeros((len(spec.weights["colors"]), 0), np.float32)
    proto = spec.with_weights(colors=none).build()
    (color,) = (tensor for tensor in proto.graph.output if tensor.name == "color")
    color.type.tensor_type.shape.dim[1].dim_value = 0
    report = validate(save(tmp_path / "a.onnx", proto), Settings(level=Level.VALUES))
    assert report.verdict == "invalid"
    assert report.outcome("GV001").status == "fail"


def test_a_vector_of_two_thousand_million_is_looked_at_in_a_moment(tmp_path):
    text = "g (float[2147483648] t) => (float[N] y) { a = Mul (t, t) y = Concat <axis = 0> (a, a) }"
    start_time = time.monotonic()
    graph = read_graph(open_model(save(tmp_path / "a.onnx", model(text))))
    assert graph.outputs[0].dims == (1 << 32,)
    assert time.monotonic() - start_time < 10  # it used to take hours, and all memory


COMPUTED_SHAPES_TEXT = """
g (float[SIZE] t, float[5,3] x) => (float[N,M] y, float[K] z) {
    all = Shape (x)
    first = Constant <value_ints = [0]> ()
    rows = Gather (all, first)
    three = Constant <value_ints = [3]> ()
    shape = Concat <axis = 0> (rows, three)
    y = Reshape (x, shape)
    z = Mul (t, t)
}
"""


@pytest.mark.parametrize("size", [8, 100_000])
def test_shapes_that_a_graph_computes_are_known_beside_long_vectors_too(tmp_path, size):
    path = save(tmp_path / "a.onnx", model(COMPUTED_SHAPES_TEXT.replace("SIZE", str(size))))
    graph = read_graph(open_model(path))
    assert [tensor.dims for tensor in graph.outputs] == [(5, 3), (size,)]
    assert graph.inference_fault == ""


def nested_functions_model(depth):
    """A model of a kilobyte that is 2 to the power of ``depth`` nodes."""
    head = '<ir_version: 10, opset_import: ["" : 18, "acme" : 1]>'
    text = f"{head} g (float[2] x) => (float[2] y) {{ y = acme.f0 (x) }}"
    for k in range(depth):
        inner = f"acme.f{k + 1}" if k < depth - 1 else "Identity"
        own = '<domain: "acme", opset_import: ["" : 18, "acme" : 1]>'
        text += f" {own} f{k} (x) => (y) {{ a = {inner} (x) y = {inner} (a) }}"
    return parser.parse_model(text)


def test_functions_that_double_and_double_are_not_expanded(tmp_path):
    _, fault = infer(nested_functions_model(8))
    assert fault == ""
    start_time = time.monotonic()
    _, fault = infer(nested_functions_model(40))
    assert fault == "its functions expand to more than 20000 nodes"
    report = validate(save(tmp_path / "a.onnx", nested_functions_model(40)), STATIC)
    assert report.verdict == "invalid"
    assert time.monotonic() - start_time < 20  # it used to take days


def test_a_function_that_calls_itself_is_a_fault():
    looping = nested_functions_model(2)
    looping.functions[1].node[0].op_type = "f0"
    looping.functions[1].node[0].domain = "acme"
    inferred, fault = infer(looping)
    assert inferred is None or fault
    assert "recursive" in fault or "Cycle" in fault


@pytest.mark.parametrize(
    ("dims", "shape", "actual"),
    [
        ([1, 3, "H", "W", 1 << 31], None, "inputs of a frame: 201326592 MiB in float64"),
        ([1, 3, "H", "W"], [1, 3, 1 << 20, 1 << 20], "inputs of a frame: 25165824 MiB"),
        ([1] * 74, None, "input image: 74 axes; expected 64 axes at most"),
        (None, [1] * 65, "input image: 65 axes in the manifest; expected 64 axes at most"),
    ],
)
def test_an_input_that_no_probe_can_hold_is_a_finding(tmp_path, dims, shape, actual):
    proto = find("post_process_any_size").draw().build()
    kind = proto.graph.input[0].type.tensor_type
    kind.ClearField("shape")
    sizes = kind.shape if dims is not None else None
    for dim in dims or ():
        sizes.dim.add(**{"dim_value" if isinstance(dim, int) else "dim_param": dim})
    (entry,) = (prop for prop in proto.metadata_props if prop.key == "gsgen.manifest")
    document = json.loads(entry.value)
    if shape:
        document["inputs"][0]["shape"] = shape
    entry.value = json.dumps(document)
    report = validate(save(tmp_path / "a.onnx", proto), Settings(level=Level.VALUES))
    assert any(
        f"{finding.where}: {finding.message}".startswith(actual) for finding in report.findings
    )
    assert report.verdict == "invalid"

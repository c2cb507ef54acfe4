import numpy as np
import pytest
from onnx import (
    AttributeProto,
    ModelProto,
    NodeProto,
    SparseTensorProto,
    TensorProto,
    numpy_helper,
    parser,
)

from gsgen.contract.model.graph import Conflict, Tensor, names_read, read_graph
from gsgen.contract.model.model_file import open_model
from support.models.small_models import model, save, weight

LARGE_WEIGHT = np.zeros(1000, np.float32)  # large enough that its values are not read


@pytest.fixture
def graph_of(tmp_path):
    def read(proto: ModelProto):
        return read_graph(open_model(save(tmp_path / "a.onnx", proto)))

    return read


CHAIN = """
chain (float[2] x, float[2] unused) => (float[2] y, float[2] z) <float[2] w = {1, 2}> {
    a = Mul (x, w)
    b = Add (a, a)
    y = Neg (b)
    c = Exp (w)
    z = Add (c, w)
}
"""


def test_inputs_outputs_and_weights_have_dtypes_and_shapes(graph_of):
    graph = graph_of(model(CHAIN))
    assert graph.inputs == (Tensor("x", "float32", (2,)), Tensor("unused", "float32", (2,)))
    assert graph.outputs == (Tensor("y", "float32", (2,)), Tensor("z", "float32", (2,)))
    assert graph.initializers == {"w": Tensor("w", "float32", (2,))}
    assert graph.output_names == ("y", "z")
    assert graph.tensors["b"] == Tensor("b", "float32", (2,))
    assert (graph.checker_fault, graph.inference_fault, graph.conflicts) == ("", "", ())


def test_tensors_are_found_by_name(graph_of):
    graph = graph_of(model(CHAIN))
    assert graph.output("z") == graph.outputs[1]
    assert graph.input("x") == graph.inputs[0]
    assert graph.output("x") is None
    assert graph.input("y") is None


def test_producers_uses_and_ancestors_follow_the_edges(graph_of):
    graph = graph_of(model(CHAIN))
    assert graph.producers["b"].op_type == "Add"
    assert "x" not in graph.producers
    assert graph.use_counts == {"x": 1, "w": 3, "a": 2, "b": 1, "c": 1, "y": 1, "z": 1}
    names, nodes = graph.ancestors("y")
    assert names == {"y", "b", "a", "x", "w"}
    assert [node.op_type for node in nodes] == ["Neg", "Add", "Mul"]
    assert graph.ancestors("x") == ({"x"}, [])


@pytest.mark.parametrize(("name", "varies"), [("y", True), ("z", False), ("x", True)])
def test_a_tensor_varies_if_an_input_is_among_its_ancestors(graph_of, name, varies):
    assert graph_of(model(CHAIN)).varies(name) is varies


def test_an_initialiser_that_is_listed_as_an_input_is_no_frame_input(graph_of):
    proto = model(CHAIN)
    proto.graph.input.add(name="w").type.CopyFrom(proto.graph.input[0].type)
    assert [tensor.name for tensor in graph_of(proto).inputs] == ["x", "unused"]


BRANCHES = """
branches (bool cond, float[1] x) => (float[M] y) {
    y = If (cond) <
        then_branch = one () => (float[p] o) { a = Neg (x) o = Add (a, THEN) },
        else_branch = two () => (float[q] p) { p = Add (x, ELSE) }
    >
}
"""


def branch(proto, index):
    """A branch of the only node, an If, in the order then, else."""
    named = {attribute.name: attribute.g for attribute in proto.graph.node[0].attribute}
    return named[("then_branch", "else_branch")[index]]


def constant(output, array, **attribute):
    value = AttributeProto(name="value", type=AttributeProto.TENSOR)
    value.t.CopyFrom(numpy_helper.from_array(array))
    for key, entry in attribute.items():
        setattr(value.t, key, entry)
    return NodeProto(op_type="Constant", output=[output], attribute=[value])


def test_subgraph_inputs_count_as_inputs_of_its_node(graph_of):
    graph = graph_of(model(BRANCHES.replace("THEN", "x").replace("ELSE", "x")))
    assert set(names_read(graph.nodes[0])) == {"cond", "x", "a", "o", "p"}
    assert graph.varies("y")
    assert [node.op_type for node in graph.all_nodes()] == ["If", "Neg", "Add", "Add"]


def test_a_size_that_the_model_leaves_open_is_inferred(graph_of):
    graph = graph_of(
        model(
            "m (float[3] x) => (float[N, M] y) { y = Unsqueeze (x, axis) }",
            weight("axis", np.array([0])),
        )
    )
    assert graph.outputs == (Tensor("y", "float32", (1, 3)),)
    assert graph.conflicts == ()


def test_a_size_that_nothing_fixes_keeps_its_symbol(graph_of):
    graph = graph_of(model("m (float[N, 3] x) => (float[N, K] y) { y = Neg (x) }"))
    assert graph.outputs == (Tensor("y", "float32", ("N", 3)),)


@pytest.mark.parametrize(
    ("declared", "conflict"),
    [
        ("float[4]", Tensor("y", "float32", (4,))),
        ("float[3, 1]", Tensor("y", "float32", (3, 1))),
        ("float[3]", None),
        ("float[N]", None),
    ],
)
def test_a_declaration_that_cannot_be_true_is_a_conflict(graph_of, declared, conflict):
    graph = graph_of(model(f"m (float[3] x) => ({declared} y) {{ y = Neg (x) }}"))
    inferred = Tensor("y", "float32", (3,))
    assert graph.conflicts == ((Conflict("y", conflict, inferred),) if conflict else ())


def test_a_wrong_declaration_in_the_middle_is_a_conflict_too(graph_of):
    proto = model("m (float[3] x) => (float[3] y) { a = Neg (x) y = Neg (a) }")
    proto.graph.value_info.add(name="a").type.CopyFrom(proto.graph.input[0].type)
    proto.graph.value_info[0].type.tensor_type.shape.dim[0].dim_value = 7
    assert [conflict.name for conflict in graph_of(proto).conflicts] == ["a"]


def test_a_wrong_dtype_is_a_conflict(graph_of):
    graph = graph_of(model("m (float[3] x) => (float16[3] y) { y = Neg (x) }"))
    assert [str(conflict.inferred) for conflict in graph.conflicts] == ["float32 [3]"]


def test_operators_whose_shapes_do_not_fit_are_an_inference_fault(graph_of):
    graph = graph_of(model("m (float[3] x, float[4] z) => (float[N] y) { y = Add (x, z) }"))
    assert "Incompatible dimensions" in graph.inference_fault
    assert "\n" not in graph.inference_fault
    assert graph.checker_fault == ""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("m (float[3] x) => (float[3] y) { y = Add (x, b) b = Neg (y) }", "topologically sorted"),
        ("m (float[3] x) => (float[3] y) { y = Add (x, ghost) }", "ghost"),
        ("m (float[3] x) => (float[3] y) { y = Concat (x, x) }", "axis"),
    ],
)
def test_checker_error_is_noted_in_one_line(graph_of, text, words):
    graph = graph_of(model(text))
    assert words in graph.checker_fault
    assert "\n" not in graph.checker_fault
    assert len(graph.checker_fault) <= 300
    assert graph.outputs == (Tensor("y", "float32", (3,)),)


def test_a_function_that_calls_itself_is_a_fault_and_no_crash(graph_of):
    proto = parser.parse_model(
        '<ir_version: 10, opset_import: ["" : 18, "l" : 1]>\n'
        "m (float[1] x) => (float[1] y) { y = l.f (x) }\n"
        '<domain: "l", opset_import: ["" : 18, "l" : 1]> f (x) => (y) { y = l.f (x) }'
    )
    graph = graph_of(proto)
    assert graph.functions == {("l", "f")}
    assert "recursive" in graph.checker_fault


def faults(graph):
    return graph.checker_fault, graph.inference_fault, graph.conflicts


SOUND = ("", "", ())


def test_weights_that_were_not_read_are_no_fault(graph_of):
    text = "m (float[1] x) => (float[N] y) { y = Add (x, w) }"
    graph = graph_of(model(text, weight("w", LARGE_WEIGHT)))
    assert faults(graph) == SOUND
    assert graph.outputs == (Tensor("y", "float32", (1000,)),)


@pytest.mark.parametrize("name", ["w", ""])
def test_a_constant_that_was_not_read_is_no_fault(graph_of, name):
    proto = model("m (float[1] x) => (float[N] y) { y = Add (x, w) }")
    proto.graph.node.insert(0, constant("w", LARGE_WEIGHT, name=name))
    graph = graph_of(proto)
    assert faults(graph) == SOUND
    assert graph.outputs == (Tensor("y", "float32", (1000,)),)
    assert len(graph.nodes) == 2


def test_a_constant_may_be_an_output_of_the_graph(graph_of):
    proto = model("m (float[1] x) => (float[N] y) { unused = Neg (x) }")
    proto.graph.node.append(constant("y", LARGE_WEIGHT))
    graph = graph_of(proto)
    assert faults(graph) == SOUND
    assert graph.outputs == (Tensor("y", "float32", (1000,)),)


@pytest.mark.parametrize(
    ("array", "dims"),
    [(np.float32(0), ()), (np.zeros(0, np.float32), (0,)), (LARGE_WEIGHT, (1000,))],
)
def test_a_constant_that_was_not_read_keeps_its_rank(graph_of, array, dims):
    proto = model("m () => (float y) { y = Identity (w) }")
    proto.graph.node.insert(0, constant("w", np.asarray(array), doc_string="words " * 1000))
    shape = proto.graph.output[0].type.tensor_type.shape
    for dim in dims:
        shape.dim.add(dim_value=dim)
    graph = graph_of(proto)
    assert faults(graph) == SOUND
    assert graph.tensors["w"].dims == dims


@pytest.mark.parametrize("form", ["initialiser", "constant"])
def test_branches_may_use_one_name_for_different_weights(graph_of, form):
    proto = model(BRANCHES.replace("THEN", "w").replace("ELSE", "w"))
    proto.graph.input[1].type.tensor_type.shape.dim[0].dim_value = 1
    for index, array in enumerate((LARGE_WEIGHT, np.zeros(2000, np.float32))):
        graph = branch(proto, index)
        if form == "initialiser":
            graph.initializer.append(weight("w", array))
        else:
            graph.node.insert(0, constant("w", array))
    graph = graph_of(proto)
    assert faults(graph) == SOUND


def test_a_branch_may_return_a_constant(graph_of):
    proto = model(BRANCHES.replace("THEN", "x").replace("ELSE", "x"))
    graph = branch(proto, 1)
    del graph.node[:]
    graph.node.append(constant("p", LARGE_WEIGHT))
    assert faults(graph_of(proto)) == SOUND


def test_a_function_may_hold_constants_that_were_not_read(graph_of):
    proto = parser.parse_model(
        '<ir_version: 10, opset_import: ["" : 18, "l" : 1]>\n'
        "m (float[1] x) => (float[N] y) { y = l.f (x) }\n"
        '<domain: "l", opset_import: ["" : 18]> f (x) => (y) { y = Add (w, x) }'
    )
    proto.functions[0].node.insert(0, constant("w", LARGE_WEIGHT))
    graph = graph_of(proto)
    assert faults(graph) == SOUND
    assert graph.outputs == (Tensor("y", "float32", (1000,)),)


def test_tensors_in_other_attributes_may_be_left_out(graph_of):
    proto = parser.parse_model(
        '<ir_version: 10, opset_import: ["" : 18, "l" : 1]>\n'
        "m (float[1] x) => (float[1] y) { y = l.f (x) }\n"
        '<domain: "l", opset_import: ["" : 18]> f <table> (x) => (y) { y = Neg (x) }'
    )
    table = proto.graph.node[0].attribute.add(name="table", type=AttributeProto.TENSOR)
    table.t.CopyFrom(weight("t", LARGE_WEIGHT))
    assert faults(graph_of(proto)) == SOUND


def sparse(values):
    dense = SparseTensorProto(dims=[2 * len(values)], values=weight("w", values))
    dense.indices.CopyFrom(numpy_helper.from_array(np.arange(len(values))))
    return dense


@pytest.mark.parametrize("size", [3, 1000])
def test_a_sparse_weight_counts_as_the_dense_one_that_it_stands_for(graph_of, size):
    proto = model("m (float[1] x) => (float[N] y) { y = Add (x, w) }")
    proto.graph.sparse_initializer.append(sparse(np.ones(size, np.float32)))
    graph = graph_of(proto)
    assert faults(graph) == SOUND
    assert graph.initializers == {"w": Tensor("w", "float32", (2 * size,))}
    assert graph.outputs == (Tensor("y", "float32", (2 * size,)),)


@pytest.mark.parametrize("size", [3, 1000])
def test_a_sparse_constant_is_no_fault(graph_of, size):
    proto = model("m (float[1] x) => (float[N] y) { y = Add (x, w) }")
    value = AttributeProto(name="sparse_value", type=AttributeProto.SPARSE_TENSOR)
    value.sparse_tensor.CopyFrom(sparse(np.ones(size, np.float32)))
    proto.graph.node.insert(0, NodeProto(op_type="Constant", output=["w"], attribute=[value]))
    graph = graph_of(proto)
    assert faults(graph) == SOUND
    assert graph.outputs == (Tensor("y", "float32", (2 * size,)),)


def test_weights_in_other_files_are_no_fault(graph_of):
    proto = model("m (float[1] x) => (float[N] y) { y = Add (x, w) }")
    tensor = proto.graph.initializer.add(name="w", data_type=TensorProto.FLOAT, dims=[7])
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="absent.bin")
    graph = graph_of(proto)
    assert faults(graph) == SOUND
    assert graph.outputs == (Tensor("y", "float32", (7,)),)


def test_a_shape_that_is_computed_from_small_integers_is_inferred(graph_of):
    text = "m (float[6] x) => (float[N, M] y) { y = Reshape (x, shape) }"
    graph = graph_of(model(text, weight("shape", np.array([2, 3]))))
    assert graph.outputs == (Tensor("y", "float32", (2, 3)),)


@pytest.mark.parametrize(
    ("tensor", "text"),
    [
        (Tensor("a", "float32", (1, "N", None)), "float32 [1, N, ?]"),
        (Tensor("a", None, None), "? [?]"),
        (Tensor("a", "int32", ()), "int32 []"),
    ],
)
def test_a_tensor_is_written_as_dtype_and_dims(tensor, text):
    assert str(tensor) == text


def test_a_sequence_output_has_no_dtype(graph_of):
    graph = graph_of(model("m (float[3] x) => (seq(float[3]) y) { y = SequenceConstruct (x) }"))
    assert graph.outputs == (Tensor("y", None, None),)

"""The facts of ONNX agree with the operator definitions of the onnx package."""

import onnx.defs
import pytest
from onnx import AttributeProto, TensorProto

from gsgen.contract.spec.onnx_facts import (
    CONTROL_FLOW,
    FLOAT_TYPES,
    INLINE_LIMIT,
    KERNEL_TYPE_INPUT,
    RANDOM_OPERATORS,
)

MAIN = [schema for schema in onnx.defs.get_all_schemas() if schema.domain == ""]


def test_operators_of_control_flow_are_those_with_graphs_as_attributes():
    graphs = (AttributeProto.GRAPH, AttributeProto.GRAPHS)
    with_graphs = {
        schema.name
        for schema in MAIN
        if any(attribute.type.value in graphs for attribute in schema.attributes.values())
    }
    # SequenceMap is a function of Loop, and no runtime keeps it.
    assert with_graphs - {"SequenceMap"} == set(CONTROL_FLOW)


def test_random_operators_are_those_with_a_seed():
    seeded = {schema.name for schema in MAIN if "seed" in schema.attributes}
    assert seeded - {"Dropout"} == set(RANDOM_OPERATORS)


def test_float_types_are_the_ieee_types_of_sixteen_bits_and_more():
    assert {TensorProto.DataType.Name(kind) for kind in FLOAT_TYPES} == {
        "FLOAT",
        "FLOAT16",
        "DOUBLE",
    }


@pytest.mark.parametrize("operator", sorted(KERNEL_TYPE_INPUT.keys() - {"Pow"}))
def test_the_kernel_input_has_the_type_of_the_result(operator):
    schema = onnx.defs.get_schema(operator)
    chosen = schema.inputs[KERNEL_TYPE_INPUT[operator]]
    assert chosen.type_str == schema.outputs[0].type_str
    assert schema.inputs[0].type_str != schema.outputs[0].type_str


def test_exponents_have_a_type_of_their_own():
    schema = onnx.defs.get_schema("Pow")
    chosen = schema.inputs[KERNEL_TYPE_INPUT["Pow"]]
    assert chosen.name == "Y"
    assert chosen.type_str != schema.outputs[0].type_str


def test_the_inline_limit_leaves_room_below_that_of_protobuf():
    assert 2**30 < INLINE_LIMIT < 2**31

"""Versions that a model declares, and the lowest ones with the same meaning."""

import pytest
from onnx import ModelProto, TensorProto

from gsgen.contract.model.versions import lowest_ir_version, operators_changed_since


def model(operators: tuple[str, ...], opset: int, ir: int, weight: int = 1) -> ModelProto:
    proto = ModelProto(ir_version=ir)
    proto.opset_import.add(domain="", version=opset)
    for operator in operators:
        proto.graph.node.add(op_type=operator)
    proto.graph.initializer.append(TensorProto(name="w", data_type=weight))
    return proto


@pytest.mark.parametrize(
    ("opset", "weight", "most", "expected"),
    [
        (18, 1, 13, 10),
        (13, 1, 13, 10),
        (18, 1, 9, 9),  # the runtime reads less than the common version
        (22, 16, 13, 10),
        (23, 1, 13, 11),
        (24, 1, 13, 12),
        (26, 1, 13, 13),
        (18, 23, 13, 11),  # float4
        (18, 25, 13, 13),  # two bits
        (28, 1, 13, 14),
    ],
)
def test_the_lowest_ir_version_follows_from_operator_set_and_types(
    opset: int, weight: int, most: int, expected: int
) -> None:
    proto = model(("Add",), opset, 14, weight)
    assert lowest_ir_version(proto, most) == expected


@pytest.mark.parametrize(
    ("operators", "opset", "lower", "changed"),
    [
        (("Add", "Mul"), 20, 18, ()),
        (("Add", "Reshape"), 21, 18, ("Reshape",)),
        (("Add", "Reshape"), 21, 21, ()),
        (("Cast",), 25, 18, ("Cast",)),
        (("Softmax",), 23, 13, ()),
        (("Nonsense",), 20, 18, ("Nonsense",)),
        (("Add",), 99, 26, ("Add",)),  # no installed ONNX knows this set
    ],
)
def test_operators_that_changed_are_listed(
    operators: tuple[str, ...], opset: int, lower: int, changed: tuple[str, ...]
) -> None:
    proto = model(operators, opset, 10)
    assert operators_changed_since(proto, lower) == changed


def test_operators_of_bodies_and_functions_count() -> None:
    proto = model(("If",), 21, 10)
    branch = proto.graph.node[0].attribute.add(name="then_branch", type=5).g
    branch.node.add(op_type="Reshape")
    proto.functions.add(name="f", domain="local").node.add(op_type="Cast")
    assert {"Reshape", "Cast"} <= set(operators_changed_since(proto, 18))

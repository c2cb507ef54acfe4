"""Models that ONNX Runtime does not load: each kind has a cause and a hint in one line."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import onnx
import pytest
from onnx import ModelProto, NodeProto, TensorProto

from gsgen.contract.model.load_failures import explain_load_failure
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits

FLOAT, DOUBLE, BFLOAT16 = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.BFLOAT16


def model(
    nodes: Sequence[NodeProto],
    *,
    types: tuple[int, int] = (FLOAT, FLOAT),
    shape: Sequence[int] = (1,),
    opset: int = 18,
    ir: int = 10,
    domains: Sequence[str] = (),
) -> ModelProto:
    result = ModelProto(ir_version=ir)
    result.opset_import.add(domain="", version=opset)
    for domain in domains:
        result.opset_import.add(domain=domain, version=1)
    result.graph.name = "graph"
    result.graph.node.extend(nodes)
    values = (result.graph.input.add(name="x"), result.graph.output.add(name="y"))
    for value, kind in zip(values, types, strict=True):
        value.type.tensor_type.elem_type = kind
        for size in shape:
            value.type.tensor_type.shape.dim.add(dim_value=size)
    return result


def node(operator: str, *inputs: str, domain: str = "", **attributes: int) -> NodeProto:
    result = NodeProto(op_type=operator, name="n", domain=domain, input=inputs, output=["y"])
    for name, value in attributes.items():
        result.attribute.add(name=name, i=value, type=onnx.AttributeProto.INT)
    return result


# A model, words of the cause, and words of the hint.
KINDS: dict[str, tuple[ModelProto, str, str]] = {
    "ir version": (model([node("Neg", "x")], ir=14), "IR version 14", "ir_version = 10"),
    "ir version of tomorrow": (model([node("Neg", "x")], ir=99), "IR version 99", "gsgen fix"),
    "operator set": (model([node("Neg", "x")], opset=99), "operator set 99", "or lower"),
    "custom domain": (
        model([node("Foo", "x", domain="com.x")], domains=["com.x"]),
        "com.x:Foo is not an operator",
        "standard ones",
    ),
    "undeclared domain": (model([node("Foo", "x", domain="com.x")]), "no version", "standard"),
    "unknown operator": (model([node("Foo", "x")]), "set 18 has no operator Foo", "declared set"),
    "no kernel": (
        model([node("Cast", "x", to=TensorProto.FLOAT4E2M1)], types=(FLOAT, 23), opset=23, ir=11),
        "no kernel for Cast of operator set 23 (node 'n')",
        "float32",
    ),
    "no kernel of an old set": (model([node("Neg", "x")], opset=1), "no kernel", "set 18"),
    "bfloat16": (
        model([node("Conv", "x", "x")], types=(BFLOAT16,) * 2, shape=(1, 1, 1, 1), opset=22),
        "no kernel for Conv",
        "float32",
    ),
    "wrong declared type": (
        model([node("Cast", "x", to=TensorProto.FLOAT16)]),
        "y (node 'n') is declared tensor(float), but is tensor(float16)",
        "Cast",
    ),
    "wrong input type": (
        model([node("Neg", "x")], types=(TensorProto.STRING,) * 2),
        "does not take tensor(string)",
        "Cast",
    ),
    "shapes": (model([node("MatMul", "x", "x")], shape=(2, 3)), "(MatMul) do not fit", "sizes"),
    "attribute": (model([node("Concat", "x")]), "'axis' is missing", "again"),
    "dangling": (model([node("Neg", "q")]), "nothing computes", "again"),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_load_failure_has_a_cause_and_a_hint(name: str, tmp_path: Path) -> None:
    proto, cause, hint = KINDS[name]
    path = tmp_path / "model.onnx"
    path.write_bytes(proto.SerializeToString())
    probe: Any = Probe(label="none", inputs={})
    with execute(path, ["y"], [probe], Limits()) as execution:
        fault = execution.fault
    assert fault is not None
    assert fault.stage == "load"
    assert cause in fault.message
    assert hint in fault.hint
    assert "onnxruntime_src" not in fault.message


def test_types_that_differ_are_named() -> None:
    failure = explain_load_failure(
        "[ONNXRuntimeError] : 1 : FAIL : Type Error: Type parameter (T) of Optype (Add) bound to "
        "different types (tensor(float) and tensor(double) in node (n1)."
    )
    assert failure.cause.startswith("Add (node 'n1') gets tensor(float) and tensor(double)")
    assert ".float()" in failure.hint


def test_an_unknown_message_keeps_its_text_without_codes() -> None:
    failure = explain_load_failure("[ONNXRuntimeError] : 1 : FAIL : something \n else")
    assert (failure.cause, failure.hint) == ("something else", "")
    assert explain_load_failure("Load model from /a/b.onnx failed:no idea").cause == "no idea"

"""The versions that a model file declares, and whether lower ones would mean the same."""

__all__ = ["lowest_ir_version", "operators_changed_since"]

from collections.abc import Iterator
from typing import Final

import onnx
from onnx import ModelProto, NodeProto

from gsgen.contract.model.model_file import declared_opset, subgraphs
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN

_COMMON_IR_VERSION: Final = 10  # what runtimes of the last years read
# The first operator set that came with each IR version, and the number of the first tensor type
# that each added; both ascend (ONNX's "Versioning" and onnx.proto3).
_OPSET_IR_VERSIONS: Final = {23: 11, 24: 12, 25: 13, 28: 14}
_TYPE_IR_VERSIONS: Final = {23: 11, 24: 12, 25: 13, 27: 14}  # 4 bits, 8 bits (e8m0), 2 bits, 6 bits


def lowest_ir_version(proto: ModelProto, most: int) -> int:
    """Return the IR version that a model needs: by its operator sets and the types of its weights.

    It is 10 where less would do, or ``most``, the highest that the runtime reads, if that is lower.
    """
    newest_type = max((tensor.data_type for tensor in proto.graph.initializer), default=0)
    needed = [
        *_ir_versions_up_to(_OPSET_IR_VERSIONS, declared_opset(proto) or 0),
        *_ir_versions_up_to(_TYPE_IR_VERSIONS, newest_type),
    ]
    return max(needed, default=min(_COMMON_IR_VERSION, most))


def _ir_versions_up_to(ir_versions: dict[int, int], number: int) -> list[int]:
    return [version for first, version in ir_versions.items() if number >= first]


def operators_changed_since(proto: ModelProto, opset: int) -> tuple[str, ...]:
    """Return the operators of a model whose meaning has changed between ``opset`` and its own set.

    Operators that the installed ONNX does not know count as changed.
    """
    declared = declared_opset(proto)
    if declared is None:
        return ()
    changed_operators: dict[str, None] = {}
    for node in _nodes(proto):
        if node.domain not in MAIN_DOMAIN:
            continue
        try:
            schema_since_version = onnx.defs.get_schema(node.op_type, declared, "").since_version
        except onnx.defs.SchemaError:
            schema_since_version = declared
        if schema_since_version > opset or declared > onnx.defs.onnx_opset_version():
            changed_operators[node.op_type] = None
    return tuple(changed_operators)


def _nodes(proto: ModelProto) -> Iterator[NodeProto]:
    """Yield the nodes of a model, of its subgraphs and of its functions."""
    pending_nodes = [*proto.graph.node]
    for function in proto.functions:
        pending_nodes += function.node
    while pending_nodes:
        node = pending_nodes.pop()
        yield node
        for attribute in node.attribute:
            for graph in subgraphs(attribute):
                pending_nodes += graph.node

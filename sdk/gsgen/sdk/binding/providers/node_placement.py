"""Reads from ONNX Runtime which provider runs each node, and cleans its error messages."""

__all__ = ["CPU", "Node", "error_text", "node_placement"]

import re
from dataclasses import dataclass
from typing import Any

CPU = "CPUExecutionProvider"

_ERROR_PREFIX = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : |\S+\.(?:cc|h):\d+ .*? was false\. "
)
_MAX_MESSAGE_LENGTH = 500


@dataclass(frozen=True, slots=True)
class Node:
    """Name and operator of a graph node, and the execution provider that runs it."""

    provider: str  # the execution provider that runs the node
    operator: str  # the node's operator
    name: str  # the node's name; empty if the model gives none


def node_placement(session: Any) -> tuple[Node, ...]:
    """Return the execution provider of every node of an ONNX Runtime session.

    The session needs ``session.record_ep_graph_assignment_info``. Before ONNX Runtime 1.24, the
    result is empty.
    """
    if not hasattr(session, "get_provider_graph_assignment_info"):
        return ()
    return tuple(
        Node(part.ep_name, node.op_type, node.name)
        for part in session.get_provider_graph_assignment_info()
        for node in part.get_nodes()
    )


def error_text(error: Exception) -> str:
    """Return an ONNX Runtime error message without codes, source files and conditions."""
    return (
        _ERROR_PREFIX.sub("", " ".join(str(error).split()))[:_MAX_MESSAGE_LENGTH]
        or type(error).__name__
    )

"""What ONNX Runtime says: where it put nodes, and what it complains of."""

__all__ = ["CPU", "Node", "placement", "words"]

import re
from dataclasses import dataclass
from typing import Any

CPU = "CPUExecutionProvider"

_CODES = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : |\S+\.(?:cc|h):\d+ .*? was false\. "
)
_LONGEST = 500


@dataclass(frozen=True, slots=True)
class Node:
    """Where ONNX Runtime put one node.

    Attributes:
        provider: The execution provider that runs it.
        operator: Its operator.
        name: Its name; empty where the model gives none.
    """

    provider: str
    operator: str
    name: str


def placement(session: Any) -> tuple[Node, ...]:
    """Return every node of a session, made with ``session.record_ep_graph_assignment_info``.

    ONNX Runtime below 1.24 does not tell; then there is none.
    """
    if not hasattr(session, "get_provider_graph_assignment_info"):
        return ()
    return tuple(
        Node(part.ep_name, node.op_type, node.name)
        for part in session.get_provider_graph_assignment_info()
        for node in part.get_nodes()
    )


def words(error: Exception) -> str:
    """Return what ONNX Runtime says, without its codes, source files and conditions."""
    return _CODES.sub("", " ".join(str(error).split()))[:_LONGEST] or type(error).__name__

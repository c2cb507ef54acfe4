"""Rule of replay (GG): a captured graph updates its outputs in every frame."""

from collections.abc import Iterator

from onnx import NodeProto

from gsgen.contract.model.buffer_copies import is_copy
from gsgen.contract.model.graph import Graph
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.fields.roles import KINDS
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule

_SCATTERS = frozenset({"ScatterElements", "ScatterND"})


def _node_location(node: NodeProto) -> str:
    return f"node {node.name or node.op_type} ({node.op_type})"


@rule(
    "GG016", Severity.WARNING, kinds=KINDS, needs=("GG019",), settled_by=("GB014", "GB016", "GB011")
)
def outputs_survive_replay(subject: InspectedModel) -> Iterator[Violation]:
    """Every output that varies by frame is written by a computing operator, not by a buffer view.

    Why:
        Graph capture records kernels, not buffer copies. An output made by Reshape, Flatten,
        Squeeze, Unsqueeze or Identity repeats the first frame for ever, without any error. So does
        one by an operator with nothing to do (a reduction over no axes, Max or Min of one input),
        and an update in place by ScatterND or ScatterElements.

    Hint:
        End the output on Cast, Concat, Mul by one, or Add of zero; reshape before that. Replace
        Scatter by Concat, Where or Gather.
    """
    graph = subject.graph
    for tensor in graph.outputs:
        location = f"output {tensor.name}"
        if graph.input(tensor.name):
            yield Violation.at(location, "an input passed through", "the result of an operator")
            continue
        if not graph.varies(tensor.name):
            continue
        producer = graph.producers.get(tensor.name)
        if producer is not None and _copies(graph, producer):
            yield Violation.at(location, f"made by {producer.op_type}", "an operator that computes")
        for node in graph.ancestors(tensor.name)[1]:
            if node.op_type in _SCATTERS and _shares_base(graph, node):
                yield Violation.at(
                    _node_location(node), "updates a tensor that others read", "Where or Concat"
                )


def _copies(graph: Graph, node: NodeProto) -> bool:
    if node.domain not in MAIN_DOMAIN:
        return False
    idle = any(
        attribute.name == "noop_with_empty_axes" and attribute.i for attribute in node.attribute
    )
    has_axes = any(attribute.name == "axes" and attribute.ints for attribute in node.attribute)
    axes_inputs = [name for name in node.input[1:2] if name]
    axes = graph.tensors.get(axes_inputs[0]) if axes_inputs else None
    empty = not axes_inputs or (axes is not None and axes.dims is not None and 0 in axes.dims)
    return is_copy(node.op_type, len(node.input), keeps_all_axes=idle and empty and not has_axes)


def _shares_base(graph: Graph, node: NodeProto) -> bool:
    base = node.input[0]
    return base not in graph.producers or graph.uses.get(base, 0) > 1

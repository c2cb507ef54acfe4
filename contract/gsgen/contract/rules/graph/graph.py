"""Rules of the graph (GG): it is well formed, portable and deterministic."""

from collections.abc import Iterator

from onnx import NodeProto

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.model_file import declared_opset
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.onnx_facts import CONTROL_FLOW, MAIN_DOMAIN
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule


def _node_location(node: NodeProto) -> str:
    return f"node {node.name or node.op_type} ({node.op_type})"


@rule("GG001", Severity.ERROR, kinds=MANIFEST_KINDS)
def opset_supported(subject: InspectedModel) -> Iterator[Violation]:
    """The target runtime supports the model's operator set and IR version.

    Why:
        A runtime refuses an operator set it does not know, and old sets lack operators and types
        that the layout needs.

    Hint:
        Export at operator set 18, which every current runtime has kernels for.
    """
    low, high = subject.target.opset
    proto = subject.file.proto
    opset = declared_opset(proto)
    if opset is None:
        yield Violation.at(
            "opset_import", "no version of the ONNX operator set", f"{low} to {high}"
        )
    elif not low <= opset <= high:
        hint = _lower_opset_hint(subject, opset, high)
        yield Violation.at("opset_import", f"operator set {opset}", f"{low} to {high}", hint=hint)
    if proto.ir_version > subject.target.ir:
        yield Violation.at(
            "ir_version",
            str(proto.ir_version),
            f"{subject.target.ir} at most",
            hint="`gsgen fix MODEL -o COPY` sets the version that the operator set and the types of "
            "the weights need; if that is too high, export at operator set 18, in float32.",
        )


def _lower_opset_hint(subject: InspectedModel, opset: int, high: int) -> str:
    """Return the hint to declare a lower operator set if no operator of the model changed since."""
    from gsgen.contract.model.versions import operators_changed_since

    if opset < high or operators_changed_since(subject.file.proto, high):
        return ""
    return f"`gsgen fix MODEL -o COPY` declares operator set {high}: no operator changed since."


@rule("GG002", Severity.ERROR, kinds=MANIFEST_KINDS)
def standard_operators(subject: InspectedModel) -> Iterator[Violation]:
    """Every operator is a standard ONNX operator, or a function that the model defines.

    Why:
        No runtime but the author's has kernels for operators of another domain.

    Hint:
        Export without custom operators; write the operation with standard ones.
    """
    graph, allowed_domains = subject.graph, subject.target.domains
    for node in graph.all_nodes():
        known = node.domain in allowed_domains or (node.domain, node.op_type) in graph.functions
        if not known:
            actual = f"domain {node.domain!r}"
            yield Violation.at(
                _node_location(node), actual, "the ONNX domain, or a function in the model"
            )


@rule("GG003", Severity.WARNING, kinds=MANIFEST_KINDS, settled_by=("GB014",))
def no_control_flow(subject: InspectedModel) -> Iterator[Violation]:
    """The graph has no If, Loop or Scan.

    Why:
        Graph capture refuses control flow, so every frame pays for launching every kernel again.

    Hint:
        `gsgen rewrite MODEL -o COPY` unrolls loops of fixed length. Compute both branches of an If,
        and select with Where.
    """
    for node in subject.graph.all_nodes():
        if node.op_type in CONTROL_FLOW and node.domain in MAIN_DOMAIN:
            yield Violation.at(_node_location(node), node.op_type, "a graph without control flow")


@rule("GG011", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GG019",))
def no_float64(subject: InspectedModel) -> Iterator[Violation]:
    """No tensor of the graph is float64.

    Why:
        WebGPU has no 64-bit floats: the node falls back to the CPU, and with graph capture the
        session is refused.

    Hint:
        Keep constants and buffers in float32; numpy and Python floats are float64 by default. Where
        that cancels out, `gsgen rewrite MODEL -o COPY` suffices.
    """
    for tensor in subject.graph.tensors.values():
        if tensor.dtype == "float64":
            is_weight = tensor.name in subject.graph.initializers
            hint = f"Store the weight {tensor.name} in float32." if is_weight else ""
            yield Violation.at(f"tensor {tensor.name}", "float64", "float32 or float16", hint=hint)


@rule("GG015", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GG019",))
def shapes_agree(subject: InspectedModel) -> Iterator[Violation]:
    """Declared shapes and dtypes agree with the shapes and dtypes that operators compute.

    Why:
        Readers allocate buffers from declared shapes; ONNX Runtime computes the real ones, and
        only warns where they differ.

    Hint:
        Run shape inference again after editing a graph, and keep its result.
    """
    for conflict in subject.graph.conflicts:
        actual = f"declared {conflict.declared}"
        yield Violation.at(f"tensor {conflict.name}", actual, f"{conflict.inferred}, as inferred")
    if subject.graph.inference_fault and not subject.graph.conflicts:
        yield Violation.at("graph", subject.graph.inference_fault, "operators whose shapes fit")


@rule("GG020", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GG019",))
def no_transposed_vector_product(subject: InspectedModel) -> Iterator[Violation]:
    """No MatMul multiplies the result of a Transpose by a vector of rank 1.

    Why:
        ONNX Runtime's optimiser (seen in 1.31) fuses the Transpose into the product, and then
        computes A v where Aᵀ v was meant. The camera centre −Rᵀ t comes out wrong without any
        error, and right again when optimisation is switched off.

    Hint:
        Give the vector a second axis: Unsqueeze it to [n, 1], multiply, and Squeeze the result.
        `gsgen rewrite MODEL -o COPY` does so.
    """
    graph = subject.graph
    for node in graph.nodes:
        if node.op_type != "MatMul" or node.domain not in MAIN_DOMAIN or len(node.input) != 2:
            continue
        producer, right = graph.producers.get(node.input[0]), graph.tensors.get(node.input[1])
        is_transposed = producer is not None and producer.op_type == "Transpose"
        if is_transposed and right is not None and right.dims is not None and len(right.dims) == 1:
            yield Violation.at(
                _node_location(node), f"Transpose times {right}", "a right operand of rank 2"
            )


@rule("GG019", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GG001", "GG002"))
def onnx_well_formed(subject: InspectedModel) -> Iterator[Violation]:
    """ONNX's own checker accepts the model.

    Why:
        A graph with a cycle, a dangling name or a missing attribute does not load anywhere.

    Hint:
        Export again, or undo the edit that broke the graph; the message is that of onnx.checker.
    """
    if subject.graph.checker_fault:
        yield Violation.at(
            "graph", subject.graph.checker_fault, "a graph that onnx.checker accepts"
        )

"""Rules of graph capture (GG): WebGPU can record every node of a frame, and replays it right.

The provider's kernels are known from measured tables, see :mod:`gsgen.contract.spec.operator_tables`.
Each node that is not captured has one cause, and each cause one rule.
"""

from collections.abc import Iterator

from onnx import NodeProto

from gsgen.contract.model.graph import Graph
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.provider_placement import Cause, Placement, is_copy, shape_arguments
from gsgen.contract.model.value_ranges import Interval, intervals
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.contract.spec.operator_tables import FAILED_OUTCOMES
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import WELL_FORMED
from gsgen.contract.validation.rule import rule

_CAPTURE_REQUIREMENT = "graph_capture"
_INT32_MIN, _INT32_MAX = -(2.0**31), 2.0**31 - 1
_SCATTER_OPERATORS = frozenset({"ScatterElements", "ScatterND"})
# The operator is not in the user's code: the SDK selects rows with it.
_SELECTION_HINT = (
    "if gsgen.sdk.math.keep_rows selects rows by TopK, multiply opacity by the mask instead"
)


def _node_location(node: NodeProto) -> str:
    return f"node {node.name or node.output[0]} ({node.op_type})"


def _placements_of_cause(subject: InspectedModel, cause: Cause) -> list[Placement]:
    return [placement for placement in subject.placements if placement.cause == cause]


def _outcomes_text(placement: Placement) -> str:
    """Return as text how each release of the target runtime executes a node."""
    runtimes_by_text = {
        FAILED_OUTCOMES[outcome]: [
            r for r, runtime_outcome in placement.outcomes.items() if runtime_outcome == outcome
        ]
        for outcome in placement.outcomes.values()
    }
    texts = [f"{text} in {' and '.join(runtimes)}" for text, runtimes in runtimes_by_text.items()]
    return f"{placement.dtype} {'; '.join(texts)}"


def _expected(subject: InspectedModel, node: NodeProto, default_hint: str) -> str:
    """Return the expectation of a node, with the remedy if the node selects rows by TopK."""
    producers = (subject.graph.producers.get(name) for name in node.input)
    is_selection = any(n is not None and n.op_type == "TopK" for n in (node, *producers))
    return f"{default_hint}; {_SELECTION_HINT}" if is_selection else default_hint


@rule(
    "GG004",
    Severity.ERROR,
    kinds=MANIFEST_KINDS,
    needs=WELL_FORMED,
    limit=_CAPTURE_REQUIREMENT,
    settled_by=("GB014", "GB015"),
)
def no_dynamic_shapes(subject: InspectedModel) -> Iterator[Violation]:
    """No tensor's shape depends on the values of a frame's inputs.

    Why:
        A recorded frame has fixed buffers. NonZero, Compress, Unique, and any shape computed from
        values, are placed on the CPU, and graph capture is then refused for the whole model.

    Hint:
        `gsgen rewrite MODEL -o COPY` where sizes can be computed; else keep all rows, set the opacity
        of those that are not wanted to zero with Where, and lower num_points.
    """
    for placement in _placements_of_cause(subject, "shape"):
        names = shape_arguments(placement.node)
        actual = f"the shape comes from {names[0]!r}" if names else "as many as values say"
        yield Violation.at(
            _node_location(placement.node), actual, "a shape that is known before the frame"
        )


@rule("GG005", Severity.ERROR, kinds=MANIFEST_KINDS, needs=WELL_FORMED, limit=_CAPTURE_REQUIREMENT)
def no_int64_compute(subject: InspectedModel) -> Iterator[Violation]:
    """No operator of a frame computes in int64 without an int64 kernel on the target runtime.

    Why:
        WebGPU has no 64-bit integers. Few operators take them by way of 32 bits; the others fall to
        the CPU, and graph capture is then refused for the whole model.

    Hint:
        `gsgen rewrite MODEL -o COPY`, or cast to int32 first; frame numbers and identities come as
        int32 already.
    """
    for placement in _placements_of_cause(subject, "int64"):
        yield Violation.at(
            _node_location(placement.node),
            _outcomes_text(placement),
            _expected(subject, placement.node, "int32, or a kernel for int64"),
        )


@rule("GG006", Severity.ERROR, kinds=MANIFEST_KINDS, needs=WELL_FORMED, limit=_CAPTURE_REQUIREMENT)
def operators_have_kernels(subject: InspectedModel) -> Iterator[Violation]:
    """WebGPU on the target runtime has a kernel for every operator of a frame, in its dtype.

    Why:
        A node without one is copied to the CPU and back every frame, and graph capture is refused
        for the whole model. A few kernels exist and compute something else.

    Hint:
        `gsgen rewrite MODEL -o COPY` writes the operation with operators that have kernels, such as
        Round as Floor(x + 0.5), and Mod as x − Floor(x / y) · y.
    """
    for placement in _placements_of_cause(subject, "operator"):
        yield Violation.at(
            _node_location(placement.node),
            _outcomes_text(placement),
            _expected(subject, placement.node, "an operator that is captured"),
        )


@rule("GG007", Severity.ERROR, kinds=MANIFEST_KINDS, needs=("GG019",), limit="split_outputs")
def narrow_concat_and_split(subject: InspectedModel) -> Iterator[Violation]:
    """A Split has no more outputs, and a Concat no more inputs, than the target GPU can bind.

    Why:
        WebGPU guarantees eight storage buffers a stage, one of them for the whole tensor. A Split
        of more fails at the first frame; onnxruntime-web 1.22 gives garbage for a wide Concat, which
        newer releases join in steps.

    Hint:
        `gsgen rewrite MODEL -o COPY`, which joins or splits seven at a time.
    """
    limits = subject.target.limits
    for placement in subject.placements:
        node = placement.node
        if node.op_type == "Split" and len(node.output) > limits["split_outputs"]:
            expected = f"{limits['split_outputs']} at most"
            yield Violation.at(_node_location(node), f"{len(node.output)} outputs", expected)
        max_concat_inputs = limits.get("concat_inputs")
        if (
            node.op_type == "Concat"
            and max_concat_inputs is not None
            and len(node.input) > max_concat_inputs
        ):
            yield Violation.at(
                _node_location(node), f"{len(node.input)} inputs", f"{max_concat_inputs} at most"
            )


@rule("GG008", Severity.ERROR, kinds=MANIFEST_KINDS, needs=WELL_FORMED, limit=_CAPTURE_REQUIREMENT)
def norms_have_kernels(subject: InspectedModel) -> Iterator[Violation]:
    """WebGPU on the target runtime has a kernel for every norm and normalisation of a frame.

    Why:
        GroupNormalization has none in current releases, LpNormalization none in onnxruntime-web
        1.22. The node falls to the CPU, and graph capture is refused for the whole model.

    Hint:
        `gsgen rewrite MODEL -o COPY` writes it out: subtract the mean, divide by the root of the mean
        square, and clamp under the root rather than add a small number.
    """
    for placement in _placements_of_cause(subject, "norm"):
        yield Violation.at(
            _node_location(placement.node), _outcomes_text(placement), "Mul, ReduceSum and Sqrt"
        )


@rule("GG018", Severity.ERROR, kinds=MANIFEST_KINDS, needs=WELL_FORMED, limit=_CAPTURE_REQUIREMENT)
def opset_has_kernels(subject: InspectedModel) -> Iterator[Violation]:
    """Operators with a WebGPU kernel on the target runtime have a supported operator set version.

    Why:
        ONNX Runtime matches a kernel only up to the last version of the operator that it was
        written for. From operator set 22 on, Sin and Cos among others are of a newer version:
        they fall to the CPU, and graph capture is refused.

    Hint:
        Export at operator set 18, or lower it with `gsgen rewrite MODEL -o COPY`.
    """
    for placement in _placements_of_cause(subject, "opset"):
        yield Violation.at(
            _node_location(placement.node), _outcomes_text(placement), "operator set 18"
        )


@rule(
    "GG009",
    Severity.INFO,
    kinds=MANIFEST_KINDS,
    needs=("GG003", "GG004", "GG005", "GG006", "GG008", "GG011", "GG018"),
    limit=_CAPTURE_REQUIREMENT,
)
def capture_foreseen(subject: InspectedModel) -> Iterator[Violation]:
    """According to operator tables, the target's GPU provider can graph-capture every node.

    Why:
        One node that is not captured makes the provider refuse capture for the whole model. This
        rule sums up: it passes if every node is known to be captured, does not apply where one of
        the rules it needs reports an obstacle, and lists operators without measurements.

    Hint:
        Run `gsgen validate --level live`, which captures the model in the real provider.
    """
    for placement in _placements_of_cause(subject, "unknown"):
        runtimes = " and ".join(placement.outcomes)
        actual = f"{placement.dtype or 'unknown dtype'} was not measured in {runtimes}"
        yield Violation.at(
            _node_location(placement.node), actual, "a measured operator", certainty="possible"
        )


@rule("GG017", Severity.ERROR, kinds=MANIFEST_KINDS, needs=WELL_FORMED, limit=_CAPTURE_REQUIREMENT)
def int64_fits_32_bits(subject: InspectedModel) -> Iterator[Violation]:
    """All int64 values that a frame computes stay within 32 bits.

    Why:
        Under graph capture the WebGPU provider computes int64 in 32 bits without saying so:
        2147483647 + 1 becomes −2147483648.

    Hint:
        Keep numbers below 2³¹; declare the range of the input that they come from, and clip before
        a cast to int64 whose range is unknown.
    """
    proto = subject.file.proto
    spans = intervals(subject.graph, proto.graph.initializer, subject.manifest)
    doubtful_names: set[str] = set()  # so are all values computed from them
    for placement in subject.placements:
        node, output_name = placement.node, placement.node.output[0]
        if not doubtful_names.isdisjoint(node.input):
            doubtful_names.add(output_name)
            continue
        if placement.cause or not _does_make_int64(subject, placement):
            continue
        span = spans.get(output_name)
        if span is None or not (span[0] >= _INT32_MIN and span[1] <= _INT32_MAX):
            doubtful_names.add(output_name)
            yield _range_violation(placement, span)


def _does_make_int64(subject: InspectedModel, placement: Placement) -> bool:
    tensor = subject.graph.tensors.get(placement.node.output[0])
    return tensor is not None and tensor.dtype == "int64"


def _range_violation(placement: Placement, span: Interval | None) -> Violation:
    location = _node_location(placement.node)
    expected = f"values from {_INT32_MIN:.0f} to {_INT32_MAX:.0f}"
    if span is None:
        actual = "int64 whose range is not known"
        return Violation.at(location, actual, expected, certainty="possible")
    return Violation.at(location, f"int64 from {span[0]:.6g} to {span[1]:.6g}", expected)


@rule(
    "GG016",
    Severity.WARNING,
    kinds=MANIFEST_KINDS,
    needs=("GG019",),
    limit=_CAPTURE_REQUIREMENT,
    settled_by=("GB014", "GB016", "GB011"),
)
def outputs_survive_replay(subject: InspectedModel) -> Iterator[Violation]:
    """Every output that varies by frame is written by a computing operator, not by a buffer view.

    Why:
        Graph capture records kernels, not buffer copies. An output made by Reshape, Flatten,
        Squeeze, Unsqueeze or Identity repeats the first frame for ever, without any error. So does
        an operator with nothing to do (Max of one input), and an update by ScatterND or
        ScatterElements.

    Hint:
        End the output on Cast, Concat, Mul by one, or Add of zero; reshape before that.
        `gsgen rewrite MODEL -o COPY` does so, and replaces Scatter.
    """
    graph = subject.graph
    for tensor in graph.outputs:
        location = f"output {tensor.name}"
        if graph.input(tensor.name):
            yield Violation.at(
                location,
                "an input passed through",
                "the result of an operator",
                hint=_passed_hint(subject, tensor.name),
            )
            continue
        if not graph.varies(tensor.name):
            continue
        producer = graph.producers.get(tensor.name)
        if producer is not None and _does_copy_input(graph, producer):
            yield Violation.at(location, f"made by {producer.op_type}", "an operator that computes")
        for node in graph.ancestors(tensor.name)[1]:
            if node.op_type in _SCATTER_OPERATORS and _does_share_base(graph, node):
                location = f"node {node.name or node.op_type} ({node.op_type})"
                actual = "updates a tensor that others read"
                yield Violation.at(location, actual, "Where or Concat")


def _passed_hint(subject: InspectedModel, name: str) -> str:
    """Return the hint to remove an input from the outputs that the manifest does not name."""
    is_declared = name in subject.output_names
    return "" if is_declared else "Remove the output from the graph: it has no role."


def _does_copy_input(graph: Graph, node: NodeProto) -> bool:
    if node.domain not in MAIN_DOMAIN:
        return False
    is_noop_with_empty_axes = any(
        attribute.name == "noop_with_empty_axes" and attribute.i for attribute in node.attribute
    )
    has_axes_attribute = any(
        attribute.name == "axes" and attribute.ints for attribute in node.attribute
    )
    axes_inputs = [name for name in node.input[1:2] if name]
    axes = graph.tensors.get(axes_inputs[0]) if axes_inputs else None
    are_axes_empty = not axes_inputs or (
        axes is not None and axes.dims is not None and 0 in axes.dims
    )
    return is_copy(
        node.op_type,
        len(node.input),
        keeps_all_axes=is_noop_with_empty_axes and are_axes_empty and not has_axes_attribute,
    )


def _does_share_base(graph: Graph, node: NodeProto) -> bool:
    base = node.input[0]
    return base not in graph.producers or graph.use_counts.get(base, 0) > 1

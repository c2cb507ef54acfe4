"""Rules of graph capture (GG): WebGPU on the target runtime can record every node of a frame.

The provider's kernels are known from measured tables, see :mod:`gsgen.contract.spec.operator_tables`.
Each node that is not captured has one cause, and each cause one rule.
"""

from collections.abc import Iterator

from onnx import NodeProto

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.provider_placement import Cause, Placement, shape_arguments
from gsgen.contract.spec.fields.roles import KINDS
from gsgen.contract.spec.operator_tables import FAILURES
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import WELL_FORMED
from gsgen.contract.validation.rule import rule

_CAPTURE = "graph_capture"
# The operator is not in the user's code: the SDK selects rows with it.
_SELECTION = (
    "if gsgen.sdk.math.keep_rows selects rows by TopK, multiply opacity by the mask instead"
)


def _node_location(node: NodeProto) -> str:
    return f"node {node.name or node.output[0]} ({node.op_type})"


def _of_cause(subject: InspectedModel, cause: Cause) -> list[Placement]:
    return [placement for placement in subject.placements if placement.cause == cause]


def _outcomes_text(placement: Placement) -> str:
    """Return as text how each release of the target runtime executes a node."""
    runtimes_by_text = {
        FAILURES[outcome]: [
            r for r, runtime_outcome in placement.outcomes.items() if runtime_outcome == outcome
        ]
        for outcome in placement.outcomes.values()
    }
    texts = [f"{text} in {' and '.join(runtimes)}" for text, runtimes in runtimes_by_text.items()]
    return f"{placement.dtype} {'; '.join(texts)}"


def _expected(subject: InspectedModel, node: NodeProto, usual: str) -> str:
    """Return the expectation of a node, with the remedy if the node selects rows by TopK."""
    producers = (subject.graph.producers.get(name) for name in node.input)
    selects = any(n is not None and n.op_type == "TopK" for n in (node, *producers))
    return f"{usual}; {_SELECTION}" if selects else usual


@rule(
    "GG004",
    Severity.ERROR,
    kinds=KINDS,
    needs=WELL_FORMED,
    limit=_CAPTURE,
    settled_by=("GB014", "GB015"),
)
def no_dynamic_shapes(subject: InspectedModel) -> Iterator[Violation]:
    """No tensor's shape depends on the values of a frame's inputs.

    Why:
        A recorded frame has fixed buffers. NonZero, Compress, Unique, and any shape computed from
        values, are placed on the CPU, and graph capture is then refused for the whole model.

    Hint:
        Keep all rows, set the opacity of those that are not wanted to zero with Where, and lower
        num_points.
    """
    for placement in _of_cause(subject, "shape"):
        names = shape_arguments(placement.node)
        actual = f"the shape comes from {names[0]!r}" if names else "as many as values say"
        yield Violation.at(
            _node_location(placement.node), actual, "a shape that is known before the frame"
        )


@rule("GG005", Severity.ERROR, kinds=KINDS, needs=WELL_FORMED, limit=_CAPTURE)
def no_int64_compute(subject: InspectedModel) -> Iterator[Violation]:
    """No operator of a frame computes in int64 without an int64 kernel on the target runtime.

    Why:
        WebGPU has no 64-bit integers. Few operators take them by way of 32 bits; the others fall to
        the CPU, and graph capture is then refused for the whole model.

    Hint:
        Cast to int32 first; frame numbers and identities come as int32 already.
    """
    for placement in _of_cause(subject, "int64"):
        yield Violation.at(
            _node_location(placement.node),
            _outcomes_text(placement),
            _expected(subject, placement.node, "int32, or a kernel for int64"),
        )


@rule("GG006", Severity.ERROR, kinds=KINDS, needs=WELL_FORMED, limit=_CAPTURE)
def operators_have_kernels(subject: InspectedModel) -> Iterator[Violation]:
    """WebGPU on the target runtime has a kernel for every operator of a frame, in its dtype.

    Why:
        A node without one is copied to the CPU and back every frame, and graph capture is refused
        for the whole model. A few kernels exist and compute something else.

    Hint:
        Write the operation with operators that have kernels: Round as Floor(x + 0.5), Mod as
        x − Floor(x / y) · y, Sign as a difference of two comparisons.
    """
    for placement in _of_cause(subject, "operator"):
        yield Violation.at(
            _node_location(placement.node),
            _outcomes_text(placement),
            _expected(subject, placement.node, "an operator that is captured"),
        )


@rule("GG007", Severity.ERROR, kinds=KINDS, needs=("GG019",), limit="split_outputs")
def narrow_concat_and_split(subject: InspectedModel) -> Iterator[Violation]:
    """A Split has no more outputs, and a Concat no more inputs, than the target GPU can bind.

    Why:
        WebGPU guarantees eight storage buffers a stage, one of them for the whole tensor. A Split
        of more fails at the first frame; onnxruntime-web 1.22 gives garbage for a wide Concat, which
        newer releases join in steps.

    Hint:
        Nest them: join or split seven at a time.
    """
    limits = subject.target.limits
    for placement in subject.placements:
        node = placement.node
        if node.op_type == "Split" and len(node.output) > limits["split_outputs"]:
            expected = f"{limits['split_outputs']} at most"
            yield Violation.at(_node_location(node), f"{len(node.output)} outputs", expected)
        widest = limits.get("concat_inputs")
        if node.op_type == "Concat" and widest is not None and len(node.input) > widest:
            yield Violation.at(
                _node_location(node), f"{len(node.input)} inputs", f"{widest} at most"
            )


@rule("GG008", Severity.ERROR, kinds=KINDS, needs=WELL_FORMED, limit=_CAPTURE)
def norms_have_kernels(subject: InspectedModel) -> Iterator[Violation]:
    """WebGPU on the target runtime has a kernel for every norm and normalisation of a frame.

    Why:
        GroupNormalization has none in current releases, LpNormalization none in onnxruntime-web
        1.22. The node falls to the CPU, and graph capture is refused for the whole model.

    Hint:
        Write it out: subtract the mean, divide by the root of the mean square, and clamp under the
        root rather than add a small number.
    """
    for placement in _of_cause(subject, "norm"):
        yield Violation.at(
            _node_location(placement.node), _outcomes_text(placement), "Mul, ReduceSum and Sqrt"
        )


@rule("GG018", Severity.ERROR, kinds=KINDS, needs=WELL_FORMED, limit=_CAPTURE)
def opset_has_kernels(subject: InspectedModel) -> Iterator[Violation]:
    """Operators with a WebGPU kernel on the target runtime have a supported operator set version.

    Why:
        ONNX Runtime matches a kernel only up to the last version of the operator that it was
        written for. From operator set 22 on, Sin and Cos among others are of a newer version:
        they fall to the CPU, and graph capture is refused.

    Hint:
        Export at operator set 18.
    """
    for placement in _of_cause(subject, "opset"):
        yield Violation.at(
            _node_location(placement.node), _outcomes_text(placement), "operator set 18"
        )


@rule(
    "GG009",
    Severity.INFO,
    kinds=KINDS,
    needs=("GG003", "GG004", "GG005", "GG006", "GG008", "GG011", "GG018"),
    limit=_CAPTURE,
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
    for placement in _of_cause(subject, "unknown"):
        runtimes = " and ".join(placement.outcomes)
        actual = f"{placement.dtype or 'unknown dtype'} was not measured in {runtimes}"
        yield Violation.at(
            _node_location(placement.node), actual, "a measured operator", certainty="possible"
        )

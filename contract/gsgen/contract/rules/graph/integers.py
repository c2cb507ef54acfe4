"""Rule of integers (GG): values of int64 computations fit in 32 bits."""

from collections.abc import Iterator

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.provider_placement import Placement
from gsgen.contract.model.value_ranges import Interval, intervals
from gsgen.contract.spec.fields.roles import KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import WELL_FORMED
from gsgen.contract.validation.rule import rule

_LOWEST, _HIGHEST = -(2.0**31), 2.0**31 - 1


@rule("GG017", Severity.ERROR, kinds=KINDS, needs=WELL_FORMED, limit="graph_capture")
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
    doubtful: set[str] = set()  # so are all values computed from them
    for placement in subject.placements:
        node, output_name = placement.node, placement.node.output[0]
        if not doubtful.isdisjoint(node.input):
            doubtful.add(output_name)
            continue
        if placement.cause or not _makes_int64(subject, placement):
            continue
        span = spans.get(output_name)
        if span is None or not (span[0] >= _LOWEST and span[1] <= _HIGHEST):
            doubtful.add(output_name)
            yield _out_of_range(placement, span)


def _makes_int64(subject: InspectedModel, placement: Placement) -> bool:
    tensor = subject.graph.tensors.get(placement.node.output[0])
    return tensor is not None and tensor.dtype == "int64"


def _out_of_range(placement: Placement, span: Interval | None) -> Violation:
    location = f"node {placement.node.name or placement.node.output[0]} ({placement.node.op_type})"
    expected = f"values from {_LOWEST:.0f} to {_HIGHEST:.0f}"
    if span is None:
        actual = "int64 whose range is not known"
        return Violation.at(location, actual, expected, certainty="possible")
    return Violation.at(location, f"int64 from {span[0]:.6g} to {span[1]:.6g}", expected)

"""GG, integers: numbers that need 64 bits, where the provider has 32."""

from collections.abc import Iterator

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.provider_placement import Placement
from gsgen.contract.model.value_ranges import Interval, intervals
from gsgen.contract.spec.roles import KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule

_LOWEST, _HIGHEST = -(2.0**31), 2.0**31 - 1


@rule(
    "GG017",
    "int64-fits-32-bits",
    Severity.ERROR,
    over="model",
    fixture="int64_beyond_32_bits",
    kinds=KINDS,
    needs=("GG001", "GG002", "GG019"),
    limit="graph_capture",
)
def int64_fits_32_bits(subject: InspectedModel) -> Iterator[Violation]:
    """What the frame computes in int64 stays within 32 bits.

    Why:
        Under graph capture the WebGPU provider computes int64 in 32 bits without saying so:
        2147483647 + 1 becomes −2147483648.

    Hint:
        Keep numbers below 2³¹; declare the range of the input that they come from, and clip before
        a cast to int64 whose range nobody can know.
    """
    proto = subject.file.proto
    spans = intervals(subject.graph, proto.graph.initializer, subject.manifest)
    doubtful: set[str] = set()  # what comes of it is doubtful for the same reason
    for one in subject.placements:
        node, made = one.node, one.node.output[0]
        if not doubtful.isdisjoint(node.input):
            doubtful.add(made)
            continue
        if one.cause or not _makes_int64(subject, one):
            continue
        span = spans.get(made)
        if span is None or not (span[0] >= _LOWEST and span[1] <= _HIGHEST):
            doubtful.add(made)
            yield _breach(one, span)


def _makes_int64(subject: InspectedModel, one: Placement) -> bool:
    tensor = subject.graph.tensors.get(one.node.output[0])
    return tensor is not None and tensor.dtype == "int64"


def _breach(one: Placement, span: Interval | None) -> Violation:
    place = f"node {one.node.name or one.node.output[0]} ({one.node.op_type})"
    expected = f"values from {_LOWEST:.0f} to {_HIGHEST:.0f}"
    if span is None:
        actual = "int64 whose range is not known"
        return Violation.at(place, actual, expected, certainty="possible")
    return Violation.at(place, f"int64 from {span[0]:.6g} to {span[1]:.6g}", expected)

"""Rules of the row count (GO): the output with the number of Gaussians in use."""

from collections.abc import Iterator

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import DECLARED
from gsgen.contract.validation.rule import rule


@rule("GO010", Severity.ERROR, needs=DECLARED)
def count_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares an output that holds the number of live Gaussians (rows in use).

    Why:
        Runtimes fetch it every frame; without it the fetch fails ("Invalid output name").

    Hint:
        Return an int32 [1] tensor, a constant where nothing varies, and declare it as outputs.count.
    """
    if subject.count is None:
        yield Violation.at("outputs", "no row count", "one int32 [1] output, usually num_points")


@rule("GO011", Severity.ERROR, needs=("GO010",))
def count_is_int32(subject: InspectedModel) -> Iterator[Violation]:
    """The output with the row count (number of Gaussians) is int32 with the static shape [1].

    Why:
        Runtimes bind four bytes to it. An int64 count is refused ("Unexpected output data type"),
        and a scalar has another rank than the buffer.

    Hint:
        Cast the count to int32 and reshape it to [1]; `gsgen explain GG016` says in which order.
    """
    tensor = subject.count
    if tensor is not None and (tensor.dtype != "int32" or tensor.dims != (1,)):
        yield Violation.at(f"output {tensor.name}", str(tensor), "int32 [1]")

"""Rules of size (GO, GL): capacity, padding rows, bytes per frame, and frame rate."""

from collections.abc import Iterator

from gsgen.contract.model.graph import tensor_bytes
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import format_mebibytes
from gsgen.contract.validation.finding import Violation, line_hint, set_hint
from gsgen.contract.validation.gates import COUNTED_ROW_RULES
from gsgen.contract.validation.rule import rule

# Capacities may be rounded up to whole workgroups.
_ROUNDING = 256
# Fewer padding rows have no measurable cost.
_MIN_WASTED_ROWS = 4096
_MIN_USED_SHARE = 0.5
_FRAME_COUNT = 60


def _is_wasteful(max_count: int, capacity: int) -> bool:
    return max_count < _MIN_USED_SHARE * capacity and capacity - max_count >= _MIN_WASTED_ROWS


@rule("GO012", Severity.INFO, needs=COUNTED_ROW_RULES[:-1])
def constant_count_fills_capacity(emission: ModelOutputs) -> Iterator[Violation]:
    """A constant row count equals the number of packed rows, except for padding to workgroups.

    Why:
        Rows behind a constant count are never used, but computed, bound and often drawn: the
        capacity could as well end there.

    Hint:
        Export with the count as capacity, or return the real count if it should vary.
    """
    subject, rows = emission.subject, emission.gaussians
    declared = subject.declared_count
    if rows is None or declared is None or subject.graph.varies(declared.name):
        return
    padding = len(rows) - emission.count
    if padding >= _ROUNDING and not _is_wasteful(emission.count, len(rows)):
        actual = f"always {emission.count}, with {padding} rows behind it"
        expected, hint = f"a capacity of {emission.count}", _shrink_hint(subject, emission.count)
        yield Violation.at(f"output {declared.name}", actual, expected, hint=hint)


def _shrink_hint(subject: InspectedModel, count: int) -> str:
    """Return the hint to end all rows behind a count; empty for models with cells of rows."""
    if subject.declared_cells is not None or not count:
        return ""
    tensors = [tensor for tensor in (subject.gaussians, subject.appearance) if tensor is not None]
    lines = [line_hint(f"{tensor.name} = {tensor.name}[:{count}]") for tensor in tensors]
    return " ".join([*lines, set_hint("outputs.gaussians.capacity", count)])


@rule("GL004", Severity.WARNING, needs=COUNTED_ROW_RULES)
def padding_is_small(behaviour: Behaviour) -> Iterator[Violation]:
    """At some probe (set of test inputs), Gaussians in use fill half of the packed rows or more.

    Why:
        Every row of the capacity is computed, kept in memory and visited every frame, regardless of
        the count. Exporters that always pad to four million rows write 464 MB a frame.

    Hint:
        Lower the capacity to the largest count that occurs.
    """
    subject = behaviour.subject
    tensor, declared = subject.gaussians, subject.declared_count
    capacity = tensor.dims[0] if tensor is not None and tensor.dims else None
    counts = [
        int(outputs[declared.name].reshape(-1)[0])
        for _, outputs in behaviour.probe_outputs
        if declared is not None
    ]
    if not isinstance(capacity, int) or not counts:
        return
    if _is_wasteful(max(counts), capacity) and declared is not None:
        actual = f"at most {max(counts)} of {capacity} rows, at {len(counts)} probes"
        expected, line = f"{_MIN_USED_SHARE:.0%} or more", _shrink_hint(subject, max(counts))
        hint = f"Lower the capacity to the largest count that occurs. If that is this one: {line}"
        yield Violation.at(f"output {declared.name}", actual, expected, hint=hint)


@rule("GL005", Severity.INFO, needs=("GM004", "GL001", "GL002"), limit="frame_bytes")
def frame_is_small(subject: InspectedModel) -> Iterator[Violation]:
    """All outputs of a frame together take fewer bytes than the target runtime allows.

    Why:
        Every byte is written by the model and read by the renderer, sixty times a second, beside
        all that the model itself reads.

    Hint:
        Use float16, fewer SH degrees or a smaller capacity.
    """
    limit = subject.target.limits["frame_bytes"]
    declared = (subject.graph.output(name) for name in subject.output_names)
    size = sum(tensor_bytes(tensor) for tensor in declared if tensor is not None)
    if size > limit:
        rate = 2 * size * _FRAME_COUNT / 1e9
        actual = (
            f"{format_mebibytes(size)} a frame, {rate:.1f} GB/s at {_FRAME_COUNT} frames a second"
        )
        yield Violation.at("outputs", actual, f"{format_mebibytes(limit, 0)} at most")


@rule("GL007", Severity.INFO, needs=("GV025", "GM004"))
def keeps_frame_rate(behaviour: Behaviour) -> Iterator[Violation]:
    """With a declared frame rate, the median run takes no longer than the time of one frame.

    Why:
        The declared rate is what a viewer plans for. Here the model runs on a CPU, so this is a
        hint: a model that is far too slow here rarely is fast enough elsewhere.

    Hint:
        Make the model smaller, or declare the rate that it reaches.
    """
    run_times = sorted(behaviour.seconds)
    for entry, tensor in behaviour.subject.inputs_of("time"):
        if not entry.fps or not run_times:
            continue
        median, slow_time = (
            run_times[len(run_times) // 2],
            run_times[int(0.95 * (len(run_times) - 1))],
        )
        if median > 1 / entry.fps:
            actual = (
                f"median {1e3 * median:.3g} ms, 95 % within {1e3 * slow_time:.3g} ms on this CPU"
            )
            expected = f"{1e3 / entry.fps:.3g} ms, as {entry.fps:g} frames a second need"
            rate = float(f"{0.9 / median:.2g}")
            path = f"{behaviour.subject.path_of(entry)}.fps"
            reached = set_hint(path, int(rate) if rate >= 1 else rate)
            yield Violation.at(
                f"input {tensor.name}",
                actual,
                expected,
                certainty="possible",
                hint=f"{reached} Or make the model smaller: this CPU computes so many frames.",
            )

"""Rules of safety (GS): a model reads no files outside its folder, and respects limits."""

from collections.abc import Iterator

from gsgen.contract.model.files_beside import weight_faults
from gsgen.contract.model.graph import tensor_bytes
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probe_plan import probed_bytes, probed_shapes
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import MEBIBYTE, format_mebibytes
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import RUNNABLE_MODEL_RULES
from gsgen.contract.validation.rule import rule

_MAX_ELEMENTS = 1 << 40
# The limit of NumPy arrays, which hold every input and output.
_MAX_AXIS_COUNT = 64
# The inputs of several probes are in memory at the same time.
_PROBES_PER_BATCH = 4


@rule("GS001", Severity.ERROR, kinds=MANIFEST_KINDS)
def external_data_inside(subject: InspectedModel) -> Iterator[Violation]:
    """External weights lie in files in or below the model's folder, and are complete.

    Why:
        A path out of the folder, or a hard link, makes the loading machine read files of the
        author's choosing; a missing or short file fails only when the model is loaded. If the model
        itself is a link, as in caches, its weights may be links to files beside its real file.

    Hint:
        Store weights inside the model or in a file beside it, and ship both.
    """
    for location, (actual, expected) in weight_faults(subject.file).items():
        yield Violation.at(f"external data {location!r}", actual, expected)


@rule("GS002", Severity.ERROR, kinds=MANIFEST_KINDS)
def sizes_sane(subject: InspectedModel) -> Iterator[Violation]:
    """Tensors of the declared sizes fit into the memory that running the model may use.

    Why:
        A few bytes of a file can ask for terabytes of memory, or for more axes than an array has.

    Hint:
        Correct the dimension; if the model is meant to be that large, raise `--memory`.
    """
    limit = subject.limits.memory
    graph = subject.graph
    for kind, tensors in (
        ("input", graph.inputs),
        ("output", graph.outputs),
        ("weight", graph.initializers.values()),
    ):
        for tensor in tensors:
            has_negative_dim = any(isinstance(dim, int) and dim < 0 for dim in tensor.dims or ())
            size = tensor_bytes(tensor)
            axes = len(tensor.dims or ())
            if has_negative_dim:
                yield Violation.at(f"{kind} {tensor.name}", f"shape {tensor}", "sizes of 0 or more")
            elif axes > _MAX_AXIS_COUNT:
                expected = f"{_MAX_AXIS_COUNT} axes at most"
                yield Violation.at(f"{kind} {tensor.name}", f"{axes} axes", expected)
            elif size > limit or size > 8 * _MAX_ELEMENTS:
                actual = f"{format_mebibytes(size, 0)}, {tensor}"
                yield Violation.at(
                    f"{kind} {tensor.name}", actual, f"{limit // MEBIBYTE} MiB at most"
                )
    for name, shape in probed_shapes(subject).items():
        input_tensor = graph.input(name)
        if len(shape) > _MAX_AXIS_COUNT and input_tensor is not None and input_tensor.dims is None:
            actual = f"{len(shape)} axes in the manifest"
            yield Violation.at(f"input {name}", actual, f"{_MAX_AXIS_COUNT} axes at most")
    probed_total, probe_limit = probed_bytes(subject), limit // _PROBES_PER_BATCH
    if probed_total > probe_limit:  # includes sizes that are not fixed in the graph
        actual = f"{format_mebibytes(probed_total, 0)} in float64 in total"
        yield Violation.at("inputs of a frame", actual, f"{probe_limit // MEBIBYTE} MiB at most")


@rule("GS004", Severity.ERROR, kinds=MANIFEST_KINDS, needs=RUNNABLE_MODEL_RULES)
def within_limits(trial: ProbeRuns) -> Iterator[Violation]:
    """The model runs within the limits on time and memory.

    Why:
        A model that takes minutes or gigabytes on the CPU blocks the viewer that loads it.

    Hint:
        Look for loops without end and for tensors that grow; raise `--timeout` or `--memory` if
        the model is meant to be that heavy.
    """
    fault = trial.execution.fault
    if fault is not None and fault.stage in ("time", "memory"):
        limit = trial.subject.sandbox_limits
        expected = f"at most {limit.seconds:g} s and {limit.memory // MEBIBYTE} MiB"
        yield Violation.at("ONNX Runtime", fault.message, expected)

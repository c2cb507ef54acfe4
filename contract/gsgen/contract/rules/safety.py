"""Rules of safety (GS): a model reads no files outside its folder, and respects limits."""

from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from stat import S_ISREG

from gsgen.contract.model.graph import tensor_bytes
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.model_file import ExternalRef
from gsgen.contract.probing.probe_plan import probed_bytes, probed_shapes
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.fields.roles import KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import MEBIBYTE, format_mebibytes
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import RUNNABLE
from gsgen.contract.validation.rule import rule

_MAX_ELEMENTS = 1 << 40
# The limit of NumPy arrays, which hold every input and output.
_MAX_AXES = 64
# The inputs of several probes are in memory at the same time.
_PROBES_AT_ONCE = 4


@rule("GS001", Severity.ERROR, kinds=KINDS)
def external_data_inside(subject: InspectedModel) -> Iterator[Violation]:
    """External weights lie in files in or below the model's folder, and are complete.

    Why:
        A path that leads out of the folder makes the machine that loads the model read files of the
        author's choosing; a missing or short file, or a length that is not that of the weight,
        fails only when the model is loaded.

    Hint:
        Store weights inside the model or in a file beside it, and ship both.
    """
    root = subject.file.path.resolve().parent
    faults: dict[str, tuple[str, str]] = {}
    for ref in subject.file.external:
        weight = subject.graph.initializers.get(ref.tensor)
        fault = _fault(ref, root, tensor_bytes(weight) if weight else 0)
        if fault is not None:
            faults.setdefault(ref.location, fault)
    for location, (actual, expected) in faults.items():
        yield Violation.at(f"external data {location!r}", actual, expected)


def _fault(ref: ExternalRef, root: Path, payload: int) -> tuple[str, str] | None:
    """Return the fault of an external weight file's path, and the expected path; None if valid."""
    windows_path, posix_path = PureWindowsPath(ref.location), PurePosixPath(ref.location)
    if not ref.location or "\0" in ref.location:
        return "no file name", "a file beside the model"
    if (
        posix_path.is_absolute()
        or windows_path.is_absolute()
        or windows_path.drive
        or ".." in windows_path.parts
    ):
        return (
            f"leads out of the model's folder (weight {ref.tensor!r})",
            "a relative path below it",
        )
    missing_file = f"no such file (weight {ref.tensor!r})", "a file beside the model"
    try:
        path = (root / ref.location).resolve()
        if not path.is_relative_to(root):
            return f"is a link to {path}", "a file below the model's folder"
        status = path.stat()  # tells why, where Path.is_file of Python 3.14 is False
    except (FileNotFoundError, NotADirectoryError):
        return missing_file
    except (OSError, RuntimeError) as error:  # the name is too long, or links form a cycle
        reason = error.strerror if isinstance(error, OSError) else "links form a cycle"
        return f"cannot be looked up: {reason}", "a file beside the model"
    if not S_ISREG(status.st_mode):
        return missing_file
    needed_bytes = ref.offset + (payload if ref.length is None else ref.length)
    if needed_bytes > status.st_size:
        return f"has {status.st_size} bytes (weight {ref.tensor!r})", f"at least {needed_bytes}"
    if payload and ref.length not in (None, payload):
        return f"declares a length of {ref.length} bytes for weight {ref.tensor!r}", f"{payload}"
    return None


@rule("GS002", Severity.ERROR, kinds=KINDS)
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
            elif axes > _MAX_AXES:
                expected = f"{_MAX_AXES} axes at most"
                yield Violation.at(f"{kind} {tensor.name}", f"{axes} axes", expected)
            elif size > limit or size > 8 * _MAX_ELEMENTS:
                actual = f"{format_mebibytes(size, 0)}, {tensor}"
                yield Violation.at(
                    f"{kind} {tensor.name}", actual, f"{limit // MEBIBYTE} MiB at most"
                )
    for name, shape in probed_shapes(subject).items():
        input_tensor = graph.input(name)
        if len(shape) > _MAX_AXES and input_tensor is not None and input_tensor.dims is None:
            actual = f"{len(shape)} axes in the manifest"
            yield Violation.at(f"input {name}", actual, f"{_MAX_AXES} axes at most")
    probed_total, probe_limit = probed_bytes(subject), limit // _PROBES_AT_ONCE
    if probed_total > probe_limit:  # includes sizes that are not fixed in the graph
        actual = f"{format_mebibytes(probed_total, 0)} in float64 in total"
        yield Violation.at("inputs of a frame", actual, f"{probe_limit // MEBIBYTE} MiB at most")


@rule("GS004", Severity.ERROR, kinds=KINDS, needs=RUNNABLE)
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

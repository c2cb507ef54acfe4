"""Rules of execution (GV): the model runs, and its outputs have the declared shapes."""

from collections.abc import Iterator

from gsgen.contract.model.graph import static_dims
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, line_hint
from gsgen.contract.validation.gates import RUNNABLE_MODEL_RULES
from gsgen.contract.validation.rule import rule


@rule("GV024", Severity.ERROR, needs=("GV025",), at_moments=True)
def shapes_as_declared(emission: ModelOutputs) -> Iterator[Violation]:
    """At run time every output has the shape and dtype that the graph declares.

    Why:
        ONNX Runtime only logs a warning where they differ, and readers have sized their buffers by
        the declaration. A viewer draws the rows that the run gave, or treats the frame as one that
        failed; it never reads beyond them.

    Hint:
        Declare what the operators compute, or give data-dependent outputs a fixed capacity.
    """
    subject: InspectedModel = emission.subject
    for tensor in subject.graph.outputs:
        value = emission.outputs.get(tensor.name)
        if value is None or tensor.dims is None:
            continue
        dims = static_dims(tensor)
        wrong_shape = dims is not None and tuple(dims) != value.shape
        if wrong_shape or (tensor.dtype in ("float32", "float16") and tensor.dtype != value.dtype):
            actual = f"{value.dtype} {list(value.shape)}"
            hint = ""
            is_matrix = dims is not None and len(dims) == value.ndim == 2
            if is_matrix and dims and int(dims[0]) > len(value) and dims[1] == value.shape[1]:
                fill = f"torch.cat([rows, torch.zeros({dims[0]}, {dims[1]}, dtype=rows.dtype)])"
                hint = f"Fill up with rows of zeros: {line_hint(f'rows = {fill}[:{dims[0]}]')}"
            yield Violation.at(f"output {tensor.name}", actual, f"{tensor}, as declared", hint=hint)


@rule("GV025", Severity.ERROR, kinds=MANIFEST_KINDS, needs=(*RUNNABLE_MODEL_RULES, "GS004"))
def model_runs(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """ONNX Runtime loads the model, and runs it with every probe (set of test inputs).

    Why:
        A model that does not run here, on the CPU with the reference kernels, runs nowhere.

    Hint:
        The message is ONNX Runtime's own; the probe names the inputs of the failed run.
    """
    fault = probe_runs.execution.fault
    if fault is not None and fault.stage not in ("time", "memory"):
        probe = (
            ""
            if fault.probe is None
            else f" at probe {probe_runs.plan.probes[fault.probe].label!r}"
        )
        actual = f"{fault.stage}{probe}: {fault.message}"
        yield Violation.at("ONNX Runtime", actual, "no error", hint=fault.hint)


@rule("GV032", Severity.ERROR, needs=("GV025", "GO004", "GO010", "GO011", "GV054"))
def something_is_drawn(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """The row count is above 0 at some probe (set of test inputs).

    Why:
        A generator without a live row at any time, camera or pose draws nothing, and a viewer
        cannot tell it from one that failed to load.

    Hint:
        Load the checkpoint before the export; return the number of live rows as the count.
    """
    declared = probe_runs.subject.declared_count
    if declared is None:
        return
    runs = probe_runs.execution.runs[: probe_runs.plan.values]
    counts = [probe_runs.execution.samples[run.sample].outputs.get(declared.name) for run in runs]
    numbers = [int(count.reshape(-1)[0]) for count in counts if count is not None and count.size]
    if numbers and not any(numbers):
        actual = f"count is 0 at all {len(numbers)} probes: nothing is drawn"
        rows, hint = probe_runs.subject.declared_gaussians, ""
        samples = [probe_runs.execution.samples[run.sample].outputs for run in runs]
        values = [outputs.get(rows.name) if rows else None for outputs in samples]
        is_visible = all(v is not None and v.ndim == 2 and (v[:, 3:4] > 0).all() for v in values)
        if rows is not None and is_visible:
            line = f"{declared.name} = {declared.name} * 0 + {rows.capacity}"
            hint = f"Return the number of live rows; all rows are visible: {line_hint(line)}"
        yield Violation.at(f"output {declared.name}", actual, "live rows at some probe", hint=hint)

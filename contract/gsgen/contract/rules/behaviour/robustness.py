"""Rules of robustness (GB, GI): extreme inputs, optimisations, and the order of runs."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.probing.behaviour_probes import REPEATED_LABEL
from gsgen.contract.probing.differences import largest_difference
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.layout import MOSTLY_INVISIBLE_SHARE, OPACITY
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.agreement import (
    FieldError,
    comparable_parts,
    field_errors,
    tolerance_of,
)
from gsgen.contract.validation.finding import Location, Violation, line_hint, set_hint
from gsgen.contract.validation.gates import FINITE_OUTPUTS, REPRODUCIBLE
from gsgen.contract.validation.report import Tolerance
from gsgen.contract.validation.rule import rule
from gsgen.contract.validation.tolerances import effective_tolerances

# The rounding error of a graph rewrite, relative to an output's largest value.
_MAX_REWRITE_ERROR = 1e-2
_MIN_INERT_SHARE = 0.5


def _failed_run_violations(runs: list[ProbeRun], hint: str = "") -> Iterator[Violation]:
    for run in runs:
        if run.error:
            actual = f"{run.error} ({run.probe.label})"
            yield Violation.at("ONNX Runtime", actual, "no error", hint=hint)
        for name in run.not_finite:
            actual = f"not finite at {run.probe.label!r}"
            yield Violation.at(f"output {name}", actual, "finite values", hint=hint)


@rule("GB013", Severity.ERROR, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS))
def edges_finite(behaviour: Behaviour) -> Iterator[Violation]:
    """Every output is finite when one input is all zero, and at both ends of all input ranges.

    Why:
        A rest pose is all zeros, a slider rests at its end, a joint turns by half a circle: norms
        of zero and logarithms of zero hide there.

    Hint:
        Clamp under the square root, and before division and logarithm. To hide such rows meanwhile,
        end on `rows = torch.where((rows.abs() < 3e38).all(1, True), rows, 0)`.
    """
    yield from _failed_run_violations(behaviour.trial_runs("edges"))


@rule("GI010", Severity.WARNING, needs=(*REPRODUCIBLE, *FINITE_OUTPUTS, "GB013"))
def beyond_range_finite(behaviour: Behaviour) -> Iterator[Violation]:
    """Just outside the declared input ranges, every output is finite and the model does not fail.

    Why:
        Timelines overshoot by a rounding error, and sliders by a pixel. An index computed from time
        then lies outside its table, and the whole frame fails.

    Hint:
        Clip inputs to their range inside the model.
    """
    ranged = (
        (entry for entry in behaviour.subject.manifest.inputs if entry.range is not None)
        if behaviour.subject.manifest
        else ()
    )
    hint = " ".join(
        line_hint(
            f"{entry.name} = {entry.name}.clamp({entry.range[0]:.9g}, {entry.range[1]:.9g})",
            first=True,
        )
        for entry in ranged
        if entry.range is not None
    )
    yield from _failed_run_violations(behaviour.trial_runs("outside"), hint)


@rule("GB010", Severity.WARNING, needs=(*REPRODUCIBLE, "GG020"), kinds=MANIFEST_KINDS)
def optimiser_agrees(behaviour: Behaviour) -> Iterator[Violation]:
    """Outputs with and without ONNX Runtime's graph optimisations agree within the tolerances.

    Why:
        Some rewrites of optimisers are wrong or amplify rounding, and each runtime has others. Rows
        and cells are compared by field with the tolerances of the configuration, the manifest or
        the contract; other outputs by a hundredth of their largest value.

    Hint:
        Find the operators by switching optimisations off one by one; write that part differently.
        Widen the tolerances only if the difference cannot be seen.
    """
    subject, base = behaviour.subject, behaviour.base
    tolerances = effective_tolerances(subject)
    for unoptimised_run in behaviour.trial_runs("plain"):
        if not unoptimised_run.outputs:
            continue
        first, second = (
            read_outputs(subject, compared_run.probe.label, compared_run.outputs)
            for compared_run in (base, unoptimised_run)
        )
        for error in field_errors(first, second, tolerances):
            yield _tolerance_violation(error, tolerance_of(error, tolerances), first)
        parts = (subject.declared_gaussians, subject.declared_appearance, subject.declared_cells)
        part_pairs = zip(parts, comparable_parts(first, second), strict=True)
        compared_names = {
            part.name for part, pair in part_pairs if part is not None and pair is not None
        }
        for name, value in base.outputs.items():
            if name not in compared_names and name in unoptimised_run.outputs:
                yield from _compare_with_loose_tolerance(name, value, unoptimised_run.outputs[name])


def _tolerance_violation(
    error: FieldError, tolerance: Tolerance, emission: ModelOutputs
) -> Violation:
    field = error.field.removeprefix("cell ")
    output = emission.color_label if field == "appearance" else emission.rows_label
    if field != error.field:
        output = emission.cells_label
    location = Location(output, field)
    actual = f"row {error.row} differs by {error.error:.3g} without optimisations"
    source = {"default": "the contract's own", "config": "by the configuration"}
    expected = (
        f"{tolerance.value:g} at most, {tolerance.unit} "
        f"({source.get(tolerance.source, 'by the manifest')})"
    )
    return Violation(where=location, expected=expected, actual=actual)


def _compare_with_loose_tolerance(
    name: str, value: np.ndarray, unoptimised_value: np.ndarray
) -> Iterator[Violation]:
    """Report an output if graph optimisation changes it by over 1 % of its largest value."""
    max_magnitude = float(np.abs(value.astype(np.float64)).max(initial=0))
    min_difference = 1.0 if value.dtype.kind in "iu" else 0.0
    largest = largest_difference(value, unoptimised_value)
    if largest > max(_MAX_REWRITE_ERROR * max_magnitude, min_difference):
        actual = f"differs by up to {largest:.3g} without optimisations"
        expected = f"{_MAX_REWRITE_ERROR * max_magnitude:.3g} at most, 1 % of the largest value"
        yield Violation.at(f"output {name}", actual, expected)


@rule("GB012", Severity.INFO, needs=REPRODUCIBLE, kinds=MANIFEST_KINDS)
def order_does_not_matter(behaviour: Behaviour) -> Iterator[Violation]:
    """Test inputs repeated in reverse order after all other runs give the same output bits.

    Why:
        State that persists between runs may show only after a while.

    Hint:
        Make every output a function of the inputs alone.
    """
    first = {_input_bytes(run.probe): run.digest for run in behaviour.values}  # labels are rounded
    for later_run in behaviour.trial_runs("again"):
        label = later_run.probe.label.removesuffix(f" {REPEATED_LABEL}")
        if later_run.digest and later_run.digest != first[_input_bytes(later_run.probe)]:
            yield Violation.at(
                f"probe {label!r}", "other output bits than in the first run", "the same bits"
            )


def _input_bytes(probe: Probe) -> tuple[bytes, ...]:
    return tuple(value.tobytes() for value in probe.inputs.values())


@rule(
    "GB009", Severity.WARNING, needs=("GV025", "GO001", "GO002", "GO010", "GO011", "GV016", "GV003")
)
def live_rows_first(behaviour: Behaviour) -> Iterator[Violation]:
    """If the row count is declared exact, most Gaussians before it are not fully transparent.

    Why:
        A renderer sorts and visits all rows before an exact count. If most are inert, the live ones
        do not stand first, and the count saves nothing.

    Hint:
        Move live rows to the front, or declare the count's semantics as "upper-bound": in the SDK,
        by the class attribute count_semantics = "upper-bound".
    """
    subject = behaviour.subject
    declared, count = subject.declared_gaussians, subject.declared_count
    if declared is None or count is None or count.semantics != "exact":
        return
    for probe, outputs in behaviour.probe_outputs:
        live = max(0, int(outputs[count.name].reshape(-1)[0]))
        opacity = outputs[declared.name][:live, OPACITY]
        inert_count = int(np.count_nonzero(opacity == 0))
        # If nearly all are inert, GV004 reports it.
        if _MIN_INERT_SHARE * len(opacity) < inert_count <= MOSTLY_INVISIBLE_SHARE * len(opacity):
            actual = (
                f"{inert_count} of {len(opacity)} counted rows have opacity 0 at {probe.label!r}"
            )
            hint = set_hint("outputs.count.semantics", "upper-bound")
            yield Violation.at(f"output {count.name}", actual, "live rows first", hint=hint)
            return

"""Rules of test vectors (GM): does the model reproduce the outputs that were recorded for it?"""

__all__ = ["vector_faults"]

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from gsgen.contract.model.graph import static_dims
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.probe_plan import probed_dtypes, probed_shapes
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.probing.test_vectors import (
    MAX_RECORDED_VECTORS,
    MAX_VECTOR_SEEDS,
    probed_seeds,
    recorded_inputs,
    recorded_label,
    vector_label,
)
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.layout import APPEARANCE_CHANNELS
from gsgen.contract.spec.manifest import TestVector, VectorRows
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.agreement import field_errors, tolerance_of
from gsgen.contract.validation.finding import Location, Violation, remove_hint
from gsgen.contract.validation.gates import (
    COLORED_ROW_RULES,
    FINITE_OUTPUTS,
    MANIFEST_PARSED,
    REPRODUCIBLE,
)
from gsgen.contract.validation.report import Tolerance
from gsgen.contract.validation.rule import rule
from gsgen.contract.validation.tolerances import effective_tolerances

Fault = tuple[str, str]

_EXPORT_AGAIN = (
    "export again if the change is not meant; where it is lower precision, raise the vector's "
    "`tolerances`"
)


@rule("GM012", Severity.WARNING, needs=(*REPRODUCIBLE, *MANIFEST_PARSED), kinds=MANIFEST_KINDS)
def test_vectors_reproduce(behaviour: Behaviour) -> Iterator[Violation]:
    """Every test vector names a known probe (test inputs), and the model reproduces its outputs.

    Why:
        A vector shows a user of the model that it runs as it did on the author's machine. The
        digest is SHA-256 over the declared outputs in order: a line "name dtype shape", then the
        bytes. Another processor may round differently, so a difference does not prove a fault.

    Hint:
        If the model is right, write all again with `gsgen vectors MODEL --into FOLDER -o COPY`.
        Models without vectors are fine.
    """
    manifest = behaviour.subject.manifest
    for index, vector in enumerate(manifest.test_vectors if manifest else ()):
        if vector.outputs:
            continue  # GM037 compares the numbers themselves
        location, result = f"manifest test_vectors.{index}", _vector_outcome(behaviour, vector)
        if isinstance(result, Violation):
            hint = remove_hint(f"test_vectors.{index}", "name a probe of the model")
            yield replace(result, where=Location(location), hint=hint)
        elif result != vector.expected_sha256:
            expected = f"the declared {vector.expected_sha256}"
            yield Violation.at(location, f"sha256 {result}", expected, certainty="possible")


def _vector_outcome(behaviour: Behaviour, vector: TestVector) -> str | Violation:
    """Return the digest of the model's outputs for a test vector's inputs, or a violation."""
    manifest, plan = behaviour.subject.manifest, behaviour.trial.plan
    assert manifest is not None
    label, same_seed = vector_label(vector.inputs, vector.seed), vector.seed == plan.seed
    if not same_seed and vector.seed not in probed_seeds(manifest, plan.seed):
        return Violation.at("", f"seed {vector.seed}", f"{MAX_VECTOR_SEEDS} other seeds at most")
    runs = behaviour.values if same_seed else behaviour.trial_runs("vectors")
    digests = {run.probe.label: run.digest for run in runs}
    digest = digests.get(vector.inputs if same_seed else label)
    if digest:
        return digest
    known = [run.probe.label for run in behaviour.values]
    planned_labels = [plan.probes[index].label for index in plan.trials.get("vectors", ())]
    if not same_seed and label in planned_labels:
        actual = f"no outputs at {label!r}"
        return Violation.at("", actual, "a run within the time limit", certainty="possible")
    actual = f"no probe {vector.inputs!r} with seed {vector.seed}"
    return Violation.at("", actual, f"one of {', '.join(map(repr, known))}")


@rule(
    "GM037",
    Severity.ERROR,
    needs=(*REPRODUCIBLE, *COLORED_ROW_RULES, *FINITE_OUTPUTS, *MANIFEST_PARSED),
)
def source_outputs_reproduced(behaviour: Behaviour) -> Iterator[Violation]:
    """The model reproduces the rows of its original (source) that test vectors record.

    Why:
        An export records rows of the torch module. A tool that edits the file later may swap
        channels, mirror an axis or lose precision: each result is plausible by itself, and only
        the rows of the source show the change.

    Hint:
        Export again. If the change is meant, as after training, remove these vectors. If it is
        lower precision, raise the vector's `tolerances`.
    """
    subject = behaviour.subject
    runs = {run.probe.label: run for run in behaviour.trial_runs("vectors")}
    recorded = 0
    for index, vector in enumerate(subject.generator.test_vectors if subject.generator else ()):
        if not vector.outputs:
            continue
        recorded += 1
        where = f"manifest test_vectors.{index}"
        hint = remove_hint(f"test_vectors.{index}", _EXPORT_AGAIN)
        if recorded > MAX_RECORDED_VECTORS:
            expected = f"{MAX_RECORDED_VECTORS} at most"
            yield Violation.at(where, f"vector {recorded} with outputs", expected, hint=hint)
        elif recorded_inputs(vector, probed_shapes(subject), probed_dtypes(subject)) is None:
            expected = "the numbers and the shape of each input of the model, and no others"
            yield Violation.at(where, "its values do not fit the inputs", expected, hint=hint)
        elif (run := runs.get(recorded_label(vector, index))) is not None:
            for fault in _run_faults(subject, vector, run):
                yield Violation.at(where, *fault, hint=hint)


def _run_faults(subject: InspectedModel, vector: TestVector, run: ProbeRun) -> Iterator[Fault]:
    from gsgen.contract.probing.sandbox_worker import subsample_step

    if run.sample is None:
        yield run.error, "a run"
        return
    steps = {}
    if run.sample.thin:
        for name in run.sample.outputs:
            tensor = subject.graph.output(name)
            dims = static_dims(tensor) if tensor else None
            steps[name] = subsample_step(dims[0]) if dims else 1
    yield from vector_faults(subject, vector, run.sample.outputs, steps)


def vector_faults(
    subject: InspectedModel,
    vector: TestVector,
    outputs: Mapping[str, np.ndarray],
    steps: Mapping[str, int],
) -> Iterator[Fault]:
    """Yield actual and expected values where a model differs from its recorded output rows.

    Args:
        subject: The model, which declares the meaning of the outputs and the tolerances.
        vector: Rows of the source's outputs.
        outputs: Output name → array, as the model computed it from the vector's inputs.
        steps: Output name → n, where only every n-th row is in ``outputs``.
    """
    # Step 1: the recorded rows of every output, of the model and of the source.
    actual, expected = {}, {}
    for part in vector.outputs:
        if part.output not in outputs:
            yield f"no output {part.output!r}", f"one of {', '.join(map(repr, outputs))}"
            return
        array, step = outputs[part.output], steps.get(part.output, 1)
        columns = array[:1].size
        if subject.declared_appearance is not None and not _is_sh_part(subject, part):
            # A fourth channel of RGB has no meaning.
            columns = min(columns, *APPEARANCE_CHANNELS["rgb"])
        fault = _record_fault(part, len(array) * step, columns, step)
        if fault is not None:
            yield fault
            return
        rows = array[np.array(part.rows, int) // step].reshape(len(part.rows), -1)
        actual[part.output] = rows[:, :columns]
        expected[part.output] = np.array(part.values, np.float32)[:, :columns]
    # Step 2: the count exactly, then rows with their colours, then cells.
    count = subject.declared_count
    if count is not None and count.name in actual:
        pair = int(actual[count.name].flat[0]), int(expected[count.name].flat[0])
        if pair[0] != pair[1]:
            yield f"{pair[0]} live rows", f"{pair[1]}, as the source gave"
            return
    yield from _row_faults(subject, vector, actual, expected)


def _is_sh_part(subject: InspectedModel, part: VectorRows) -> bool:
    declared = subject.declared_appearance
    return declared is None or part.output != declared.name or declared.space == "sh"


def _record_fault(part: VectorRows, length: int, columns: int, step: int) -> Fault | None:
    """Return the fault that keeps recorded rows from comparison with model outputs, or None."""
    if len(part.rows) != len(part.values) or not part.rows:
        return f"{len(part.values)} lists of values", f"one for each of {len(part.rows)} rows"
    if max(part.rows) >= length:
        return f"row {max(part.rows)} of {part.output!r}", f"less than {length}"
    if any(row % step for row in part.rows):
        row = next(row for row in part.rows if row % step)
        return f"row {row} of {part.output!r}", f"a multiple of {step}, since others are not kept"
    lengths = {len(values) for values in part.values}
    if min(lengths) < columns or len(lengths) > 1:
        return f"{min(lengths)} values in a row of {part.output!r}", f"{columns}"
    return None


def _row_faults(
    subject: InspectedModel,
    vector: TestVector,
    actual: Mapping[str, np.ndarray],
    expected: Mapping[str, np.ndarray],
) -> Iterator[Fault]:
    numbers = {part.output: part.rows for part in vector.outputs}
    rows, color, cells = (
        getattr(subject, f"declared_{field}") for field in ("gaussians", "appearance", "cells")
    )
    if color is not None and numbers.get(color.name, ()) != numbers.get(rows.name, ()):
        yield f"rows of {color.name!r}", f"the same rows as of {rows.name!r}"
        return
    names = [declared.name for declared in (rows, color) if declared is not None]
    first, second = (
        read_outputs(subject, vector.inputs, {name: side[name] for name in names if name in side})
        for side in (actual, expected)
    )
    tolerances = _vector_tolerances(subject, vector)
    yield from _field_faults(first, second, tolerances, numbers.get(rows.name, ()), "row")
    if cells is not None and cells.name in actual:
        # A visibility is compared as an opacity.
        first, second = (
            replace(
                outputs,
                gaussians=side[cells.name],
                count=len(side[cells.name]),
                appearance=None,
                cells=None,
            )
            for outputs, side in ((first, actual), (second, expected))
        )
        yield from _field_faults(first, second, tolerances, numbers[cells.name], "cell")


def _field_faults(
    actual: ModelOutputs,
    expected: ModelOutputs,
    tolerances: tuple[Tolerance, ...],
    numbers: tuple[int, ...],
    element_name: str,
) -> Iterator[Fault]:
    for error in field_errors(expected, actual, tolerances):
        field_tolerance = tolerance_of(error, tolerances)
        yield (
            f"{field_tolerance.field} of {element_name} {numbers[error.row]} is {error.error:.3g} from the "
            "source's",
            f"at most {field_tolerance.value:g} ({field_tolerance.unit})",
        )


def _vector_tolerances(subject: InspectedModel, vector: TestVector) -> tuple[Tolerance, ...]:
    """Return tolerances for a test vector: the user's, else the vector's, else the manifest's."""
    vector_tolerances = vector.tolerances
    return tuple(
        tolerance
        if vector_tolerances is None or tolerance.source == "config"
        else replace(
            tolerance, value=getattr(vector_tolerances, tolerance.field), source="manifest"
        )
        for tolerance in effective_tolerances(subject)
    )

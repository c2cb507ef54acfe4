"""Verifies an exported file: outputs agree with torch, and frames are independent."""

__all__ = ["check_memory", "check_parity", "run_exported"]

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import GeneratorManifest, Tolerances
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.output_names import output_names
from gsgen.sdk.errors import GeneratorInvalid, ParityFailed
from gsgen.sdk.exporting.eager_reference import EagerRuns, run_eager, run_in_float64
from gsgen.sdk.exporting.frame_size import frame_bytes
from gsgen.sdk.exporting.parity_diagnosis import ParitySuspects, diagnose, low_precision_hint
from gsgen.sdk.exporting.pipeline import ExportOptions
from gsgen.sdk.exporting.source_vectors import RowRecorder
from gsgen.sdk.exporting.tracing.hazards import HazardWatch
from gsgen.sdk.model_runs import run_in_groups
from gsgen.sdk.parity import Comparison, ModelOutput, Parity, Reference, references_equal

# Relative change of inputs that finds rows at a threshold: a few times the rounding of kernels.
_INPUT_PERTURBATION = 1e-5
_PAIR_COUNT = 3
# Sums over many threads differ by this much, relatively, from run to run.
_STATE_TOLERANCE = 1e-5


def check_parity(
    path: Path,
    manifest: GeneratorManifest,
    references: EagerRuns,
    suspects: ParitySuspects,
    options: ExportOptions,
    recorder: RowRecorder,
    allowed: Tolerances | None = None,
    roundings: int = 1,
) -> Parity:
    """Compare an exported model with eager torch, for normal test inputs and far cameras.

    ``allowed`` are the manifest's tolerances by default; the rounding of stored outputs is added to
    them ``roundings`` times. The error names the field, the row, and the likely cause. ``recorder``
    keeps rows of the compared runs.
    """

    def nearby(reference: Reference) -> Iterator[Reference]:
        probes = _perturbed_probes(reference.probe)
        return (run_eager(suspects.generator, probe, checked=False) for probe in probes)

    def exact(reference: Reference) -> Reference | None:
        return run_in_float64(suspects.generator, reference.probe)

    comparison = Comparison(
        allowed or manifest.tolerances or Tolerances(),
        roundings=roundings,
        nearby=nearby,
        exact=exact,
        # Where values tie, kernels of sorts order rows in their own way.
        ignores_row_order=any(hazard.kind == "order" for hazard in suspects.hazards),
    )
    try:
        for index, outputs in enumerate(
            _outputs_of_probes(path, manifest, references.probes, options.limits)
        ):
            options.progress(f"comparing with eager torch: probe {index + 1} of {len(references)}")
            recorder.add_run(index, outputs)
            comparison.add(references[index], _output(outputs, manifest))
    except ParityFailed as error:  # the model does not run
        hint = low_precision_hint(suspects.generator, references.probes[-1]) or error.hint
        raise ParityFailed(error.message, where=error.where, hint=hint) from error
    parity = comparison.parity
    if parity.holds:
        return parity

    def run(probes: list[Probe]) -> list[ModelOutput]:
        return [
            _output(outputs, manifest).copy()
            for outputs in _outputs_of_probes(path, manifest, probes, options.limits)
        ]

    worst_field = max(parity.fields, key=lambda field: field.excess)
    element = "cell" if worst_field.field.startswith("cell") else "Gaussian"
    cause = diagnose(suspects, manifest, references, run)
    raise ParityFailed(
        f"{worst_field.field} of {element} {worst_field.row} differs by {worst_field.error:.3g} for the test inputs "
        f"{worst_field.probe!r}, {worst_field.excess:.3g} times the tolerance{cause.reason} "
        f"({parity.describe()})",
        where=cause.where or path.name,
        hint=cause.hint,
        parity=parity,
    )


def _perturbed_probes(probe: Probe) -> Iterator[Probe]:
    """Yield pairs of test inputs in which each float is slightly increased or decreased."""
    rng = np.random.default_rng(0)
    for _ in range(_PAIR_COUNT):
        signs = {name: rng.choice([-1, 1], array.shape) for name, array in probe.inputs.items()}
        for factor in (_INPUT_PERTURBATION, -_INPUT_PERTURBATION):
            perturbed_input_values = {
                name: (array * (1 + factor * signs[name])).astype(array.dtype)
                if array.dtype.kind == "f"
                else array
                for name, array in probe.inputs.items()
            }
            yield replace(probe, inputs=perturbed_input_values)


def _outputs_of_probes(
    path: Path, manifest: GeneratorManifest, probes: Sequence[Probe], limits: Limits
) -> Iterator[dict[str, np.ndarray]]:
    """Yield a model's outputs for each set of test inputs; arrays are valid until the next one."""
    names = output_names(manifest)
    return run_exported(path, names, probes, limits, frame_bytes=frame_bytes(manifest))


def _output(outputs: dict[str, np.ndarray], manifest: GeneratorManifest) -> ModelOutput:
    rows, color, count, *cells = (outputs[name] for name in output_names(manifest))
    return ModelOutput(rows, color, int(np.ravel(count)[0]), *cells)


def run_exported(
    path: Path, names: Sequence[str], probes: Sequence[Probe], limits: Limits, *, frame_bytes: int
) -> Iterator[dict[str, np.ndarray]]:
    """Run an exported model for each set of test inputs, and yield its outputs by name."""

    def failure(message: str, hint: str) -> ParityFailed:
        return ParityFailed(
            f"ONNX Runtime cannot run the exported model: {message}", where=path.name, hint=hint
        )

    limits = limits.for_model(open_model(path).weight_bytes + frame_bytes)
    return run_in_groups(path, names, probes, limits, frame_bytes=frame_bytes, failure=failure)


def check_memory(generator: GaussianGenerator, watch: HazardWatch, references: EagerRuns) -> None:
    """Raise if a torch module's result depends on earlier frames, by its changed state.

    A value that forward keeps from its first frame stays the same in the model, too, so comparing
    the two does not find it.
    """
    if not watch.changes_module:
        return
    watch.restore_module()
    reference = references[-1]
    if references_equal(reference, run_eager(generator, reference.probe), _STATE_TOLERANCE):
        return
    state_changes = [hazard for hazard in watch.hazards if hazard.kind == "state"]
    raise GeneratorInvalid(
        f"forward remembers earlier frames: for the test inputs {reference.probe.label!r}, its result from the "
        "initial state differs from its result after other frames",
        where="; ".join(hazard.where for hazard in state_changes[:3]),
        hint=state_changes[0].hint if state_changes else "",
    )

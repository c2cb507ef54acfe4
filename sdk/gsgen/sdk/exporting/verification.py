"""Verifies an exported file: its outputs agree with torch, and frames are independent."""

__all__ = ["check_memory", "check_parity", "run_exported"]

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import GeneratorManifest, Tolerances
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.packed_module import output_names
from gsgen.sdk.errors import GeneratorInvalid, ParityFailed
from gsgen.sdk.exporting.eager_reference import run_eager
from gsgen.sdk.exporting.parity_diagnosis import Suspects, diagnose
from gsgen.sdk.exporting.pipeline import Progress
from gsgen.sdk.exporting.trace_hazards import Watch
from gsgen.sdk.parity import ModelOutput, Parity, Reference, compare, references_equal

# Relative change of inputs that finds rows at a threshold: a few times the rounding of kernels.
_NUDGE = 1e-5
_PAIRS = 3
# Sums over many threads differ by this much, relatively, from run to run.
_ROUNDING = 1e-5


def check_parity(
    path: Path,
    manifest: GeneratorManifest,
    references: list[Reference],
    suspects: Suspects,
    progress: Progress,
    allowed: Tolerances | None = None,
    roundings: int = 1,
) -> Parity:
    """Compare an exported model with eager torch, at the contract's test inputs and far from them.

    ``allowed`` are the manifest's tolerances by default; the rounding of stored outputs is added to
    them ``roundings`` times. The error names the field, the row, and the likely cause.
    """
    progress(f"comparing with eager torch at {len(references)} probes")
    outputs = _run(path, manifest, [reference.probe for reference in references])
    tolerances = allowed or manifest.tolerances or Tolerances()
    parity = compare(references, outputs, tolerances, roundings=roundings)
    if not parity.holds:
        near = _neighbours(suspects.generator, references, outputs, tolerances)
        parity = compare(references, outputs, tolerances, roundings=roundings, neighbours=near)
    if parity.holds:
        return parity

    def run(probes: list[Probe]) -> list[ModelOutput]:
        return _run(path, manifest, probes)

    worst = max(parity.fields, key=lambda field: field.excess)
    element = "cell" if worst.field.startswith("cell") else "Gaussian"
    reason, hint = diagnose(suspects, manifest, references, run)
    raise ParityFailed(
        f"{worst.field} of {element} {worst.row} is off by {worst.error:.3g} at probe "
        f"{worst.probe!r}, {worst.excess:.3g} times the tolerance{reason} "
        f"({parity.describe()})",
        where=path.name,
        hint=hint,
        parity=parity,
    )


def _neighbours(
    generator: GaussianGenerator,
    references: list[Reference],
    outputs: list[ModelOutput],
    tolerances: Tolerances,
) -> dict[int, list[Reference]]:
    """Run torch at slightly changed inputs wherever the exported model differs from torch."""
    differing = [
        index
        for index, (reference, output) in enumerate(zip(references, outputs, strict=True))
        if not compare([reference], [output], tolerances).holds
    ]
    return {
        index: [run_eager(generator, probe) for probe in _nudged(references[index].probe)]
        for index in differing
    }


def _nudged(probe: Probe) -> Iterator[Probe]:
    """Yield pairs of inputs on opposite sides of ``probe``, with each float moved slightly."""
    rng = np.random.default_rng(0)
    for _ in range(_PAIRS):
        signs = {name: rng.choice([-1, 1], array.shape) for name, array in probe.inputs.items()}
        for side in (_NUDGE, -_NUDGE):
            moved = {
                name: (array * (1 + side * signs[name])).astype(array.dtype)
                if array.dtype.kind == "f"
                else array
                for name, array in probe.inputs.items()
            }
            yield replace(probe, inputs=moved)


def _run(path: Path, manifest: GeneratorManifest, probes: list[Probe]) -> list[ModelOutput]:
    rows, color, count, *cells = names = output_names(manifest)
    return [
        ModelOutput(
            run_outputs[rows],
            run_outputs[color],
            int(np.ravel(run_outputs[count])[0]),
            *(run_outputs[n] for n in cells),
        )
        for run_outputs in run_exported(path, names, probes)
    ]


def run_exported(
    path: Path, names: Sequence[str], probes: Sequence[Probe]
) -> list[dict[str, np.ndarray]]:
    """Run an exported model for each set of test inputs, and return its outputs by name."""
    limits = Limits().for_model(open_model(path).weight_bytes)
    with execute(path, names, probes, limits) as execution:
        if execution.fault is not None:
            message = f"ONNX Runtime cannot run the exported model: {execution.fault.message}"
            raise ParityFailed(message, where=path.name)
        # Samples lie in files that the execution deletes when it ends.
        return [
            {name: np.array(execution.samples[run.sample].outputs[name]) for name in names}
            for run in execution.runs
        ]


def check_memory(generator: GaussianGenerator, watch: Watch, references: list[Reference]) -> None:
    """Raise if a module that changes its own state gives another result from its initial state.

    A value that forward keeps from its first frame stays the same in the model, too, so comparing
    the two does not find it.
    """
    if not watch.changes_module:
        return
    watch.undo()
    reference = references[-1]
    if references_equal(reference, run_eager(generator, reference.probe), _ROUNDING):
        return
    changes = [hazard for hazard in watch.hazards if hazard.kind == "state"]
    raise GeneratorInvalid(
        f"forward remembers earlier frames: at probe {reference.probe.label!r}, its result from the "
        "initial state differs from its result after other frames",
        where="; ".join(hazard.where for hazard in changes[:3]),
        hint=changes[0].hint if changes else "",
    )

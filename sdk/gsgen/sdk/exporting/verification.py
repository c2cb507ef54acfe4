"""What an exported file must stand before it is put in its place: parity, memory, the contract."""

__all__ = ["check_contract", "check_memory", "check_parity", "run_exported"]

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import GeneratorManifest, Tolerances
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.packed_module import output_names
from gsgen.sdk.errors import ExportRejected, GeneratorInvalid, ParityFailed
from gsgen.sdk.exporting.eager_reference import run_eager
from gsgen.sdk.exporting.parity_diagnosis import Suspects, explain
from gsgen.sdk.exporting.trace_hazards import Watch
from gsgen.sdk.parity import ModelOutput, Parity, Reference, compare, same

# How far inputs are moved to find rows that jump: some times what kernels round.
_NUDGE = 1e-5
_PAIRS = 3
# Sums of many threads differ by this much from run to run.
_ROUNDING = 1e-5


def check_parity(
    path: Path,
    manifest: GeneratorManifest,
    references: list[Reference],
    suspects: Suspects,
    progress: Callable[[str], None],
    allowed: Tolerances | None = None,
    roundings: int = 1,
) -> Parity:
    """Compare the file with eager torch, at the contract's probes and far from them.

    Args:
        path: The model.
        manifest: What it declares.
        references: What eager torch gave.
        suspects: What may explain a difference.
        progress: Called with a few words.
        allowed: What may differ; what the manifest declares where absent.
        roundings: How often what storing outputs rounds may be added to the tolerances.

    Raises:
        ParityFailed: They differ; the error says where, and what of the module may be why.
    """
    progress(f"comparing with eager torch at {len(references)} probes")
    outputs = _run(path, manifest, [reference.probe for reference in references])
    tolerances = allowed or manifest.tolerances or Tolerances()
    parity = compare(references, outputs, tolerances, roundings=roundings)
    if not parity.holds:
        near = _neighbours(suspects.generator, references, outputs, tolerances)
        parity = compare(
            references, outputs, tolerances, roundings=roundings, neighbours=near
        )
    if parity.holds:
        return parity

    def run(probes: list[Probe]) -> list[ModelOutput]:
        return _run(path, manifest, probes)

    worst = max(parity.fields, key=lambda field: field.excess)
    whose = "cell" if worst.field.startswith("cell") else "Gaussian"
    reason, hint = explain(suspects, manifest, references, run)
    raise ParityFailed(
        f"{worst.field} of {whose} {worst.row} is off by {worst.error:.3g} at probe "
        f"{worst.probe!r}, {worst.excess:.3g} times what is allowed{reason} "
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
    """Run torch a hair beside each probe at which the model differs."""
    differing = [
        index
        for index, (reference, made) in enumerate(zip(references, outputs, strict=True))
        if not compare([reference], [made], tolerances).holds
    ]
    return {
        index: [run_eager(generator, one) for one in _nudged(references[index].probe)]
        for index in differing
    }


def _nudged(probe: Probe) -> Iterator[Probe]:
    """Yield pairs of probes on opposite sides of ``probe``, their floats moved a little."""
    rng = np.random.default_rng(0)
    for _ in range(_PAIRS):
        signs = {name: rng.choice([-1, 1], one.shape) for name, one in probe.inputs.items()}
        for side in (_NUDGE, -_NUDGE):
            moved = {
                name: (one * (1 + side * signs[name])).astype(one.dtype)
                if one.dtype.kind == "f"
                else one
                for name, one in probe.inputs.items()
            }
            yield replace(probe, inputs=moved)


def _run(path: Path, manifest: GeneratorManifest, probes: list[Probe]) -> list[ModelOutput]:
    rows, color, count, *cells = names = output_names(manifest)
    return [
        ModelOutput(
            one[rows], one[color], int(np.ravel(one[count])[0]), *(one[n] for n in cells)
        )
        for one in run_exported(path, names, probes)
    ]


def run_exported(
    path: Path, names: Sequence[str], probes: Sequence[Probe]
) -> list[dict[str, np.ndarray]]:
    """Run a model that was just exported; return its outputs, by name, at each probe.

    Raises:
        ParityFailed: ONNX Runtime cannot run it.
    """
    limits = Limits().for_model(open_model(path).weight_bytes)
    with execute(path, names, probes, limits) as execution:
        if execution.fault is not None:
            what = f"ONNX Runtime cannot run the exported model: {execution.fault.message}"
            raise ParityFailed(what, where=path.name)
        # Samples lie in files that are gone with the execution.
        return [
            {name: np.array(execution.samples[run.sample].outputs[name]) for name in names}
            for run in execution.runs
        ]


def check_memory(
    generator: GaussianGenerator, watch: Watch, references: list[Reference]
) -> None:
    """Start a module that changes itself anew, and see that a frame does not depend on it.

    A value that forward keeps from its first frame stays the same in the model, too, so parity
    does not see it.

    Raises:
        GeneratorInvalid: Another result comes out.
    """
    if not watch.changes_module:
        return
    watch.undo()
    known = references[-1]
    if same(known, run_eager(generator, known.probe), _ROUNDING):
        return
    changes = [one for one in watch.hazards if one.kind == "state"]
    raise GeneratorInvalid(
        f"forward remembers earlier frames: begun at probe {known.probe.label!r}, it gives "
        "another result than when it comes there from others",
        where="; ".join(one.where for one in changes[:3]),
        hint=changes[0].hint if changes else "",
    )


def check_contract(
    draft: Path,
    path: Path,
    target: str,
    settings: Settings | None,
    progress: Callable[[str], None],
) -> Report:
    """Validate the file.

    Raises:
        ExportRejected: It breaks a rule; the error carries the report.
    """
    base = settings or Settings(level=Level.BEHAVIOUR)
    settings = replace(base, target=load_target(target))
    report = replace(validate(draft, settings, progress=progress), path=str(path))
    if report.verdict != "conforms":
        broken = [
            finding for finding in report.findings if finding.severity >= Severity.ERROR
        ]
        listed = "; ".join(
            f"{f.rule} {f.where}: {f.message}" for f in broken or report.findings
        )
        hint = (broken or report.findings)[0].hint if report.findings else ""
        raise ExportRejected(listed, report, where=path.name, hint=hint)
    return report

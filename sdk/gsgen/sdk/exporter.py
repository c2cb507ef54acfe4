"""Export a generator: trace it, finish the graph, validate the file, compare it with torch.

The file appears at its place only if all of that succeeded.
"""

__all__ = ["Exported", "Progress", "export"]

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from gsgen.contract.config import Settings
from gsgen.contract.engine import validate
from gsgen.contract.finding import Level, Severity
from gsgen.contract.manifest import (
    AppearanceOutput,
    Bounds,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Producer,
    Tolerances,
)
from gsgen.contract.probes import Probe, default_probes
from gsgen.contract.report import Report
from gsgen.contract.roles import ROLES
from gsgen.contract.sandbox import Limits, execute
from gsgen.contract.targets import load_target
from gsgen.sdk.eager import Reference, measure_bounds, run_eager
from gsgen.sdk.errors import ExportRejected, GeneratorInvalid, ParityFailed
from gsgen.sdk.finish import finish
from gsgen.sdk.generator import GaussianGenerator
from gsgen.sdk.packing import (
    APPEARANCE_RGB,
    APPEARANCE_SH,
    COUNT,
    GAUSSIANS,
    Packed,
    PackedGenerator,
)
from gsgen.sdk.parity import Parity, compare
from gsgen.sdk.placement import draft_of
from gsgen.sdk.rewrite import Change
from gsgen.sdk.saving import save_model
from gsgen.sdk.trace import trace

Dtype = Literal["float32", "float16"]
Progress = Callable[[str], None]

OPSET = 18
_TOLERANCES = Tolerances()


def _silent(_: str) -> None:
    return


@dataclass(frozen=True, slots=True)
class Exported:
    """A finished export.

    Attributes:
        path: The file.
        manifest: What was embedded.
        parity: How closely it agrees with eager torch.
        report: What the validator says; it conforms.
        changes: What the rewrites did to the graph.
    """

    path: Path
    manifest: GeneratorManifest
    parity: Parity
    report: Report
    changes: tuple[Change, ...] = ()


def export(
    generator: GaussianGenerator,
    path: str | os.PathLike[str],
    *,
    name: str | None = None,
    dtype: Dtype = "float32",
    capacity: int | None = None,
    opset: int = OPSET,
    target: str = "core",
    rewrite: bool = True,
    settings: Settings | None = None,
    progress: Progress = _silent,
) -> Exported:
    """Write ``generator`` as an ONNX Gaussian Generator that conforms and agrees with torch.

    Args:
        generator: The module; it is put into evaluation mode.
        path: Where the model goes; it is replaced only by a model that passed every check.
        name: What people call it; the file's stem where absent.
        dtype: Of both outputs.
        capacity: Rows of the outputs; as many as there are Gaussians where absent.
        opset: ONNX operator set, 18 being the one that every runtime has kernels for.
        target: The consumer to rewrite and validate for.
        rewrite: Rewrite the graph so that it is captured; without, it stays as torch wrote it.
        settings: Limits and severities of that validation.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        GeneratorInvalid: The module declares or returns something the contract does not know.
        ExportFailed: Torch could not export it.
        ParityFailed: The model computes something else than the module.
        ExportRejected: The model breaks a rule; the error carries the report.
    """
    path = Path(path)
    generator = generator.eval()
    progress("running the module in eager torch")
    manifest, references = _describe(generator, name or path.stem, dtype, capacity)
    gaussians = manifest.outputs.gaussians
    assert gaussians is not None
    packed = PackedGenerator(generator, Packed(getattr(torch, dtype), gaussians.capacity))
    progress("tracing the graph")
    example = references[min(1, len(references) - 1)].probe
    model = trace(packed, example, manifest, opset)
    progress("rewriting the graph")
    changes = finish(model, manifest, load_target(target), rewrite=rewrite)
    with draft_of(path) as draft:
        save_model(model, draft)
        parity = _check_parity(draft, manifest, references, progress)
        report = _check_contract(draft, target, settings, progress)
    return Exported(path, manifest, parity, replace(report, path=str(path)), tuple(changes))


def _describe(
    generator: GaussianGenerator, name: str, dtype: Dtype, capacity: int | None
) -> tuple[GeneratorManifest, list[Reference]]:
    """Build the manifest from what the module declares and what it emits."""
    _check_inputs(generator)
    draft = _manifest(generator, name, dtype, None, 1, None)
    first = [run_eager(generator, probe) for probe in _probes(draft)]
    made = first[0].gaussians
    rows = capacity if capacity is not None else len(made)
    if rows < len(made):
        raise GeneratorInvalid(
            f"capacity {rows} is less than the {len(made)} Gaussians",
            where="capacity",
            mend=f"Give {len(made)} or more.",
        )
    bounds = measure_bounds(first)
    draft = _manifest(generator, name, dtype, made.degree, rows, bounds)
    if not generator.inputs:
        return draft, first
    # Cameras orbit the bounds, so probes are laid out again around the measured ones.
    references = [run_eager(generator, probe) for probe in _probes(draft)]
    bounds = measure_bounds(first + references)
    return replace(draft, bounds=bounds), references


def _check_inputs(generator: GaussianGenerator) -> None:
    names = [entry.name for entry in generator.inputs]
    where = f"{type(generator).__name__}.inputs"
    for entry in generator.inputs:
        if names.count(entry.name) > 1:
            mend = "Give each input a name of its own."
            raise GeneratorInvalid(f"{entry.name!r} stands twice", where=where, mend=mend)
        if entry.shape is None:
            mend = "Make inputs with the functions of gsgen.sdk.inputs."
            raise GeneratorInvalid(f"{entry.name!r} has no shape", where=where, mend=mend)


def _manifest(
    generator: GaussianGenerator,
    name: str,
    dtype: Dtype,
    degree: int | None,
    capacity: int,
    bounds: Bounds | None,
) -> GeneratorManifest:
    space: Literal["sh", "rgb"] = "rgb" if degree is None else "sh"
    color_name = APPEARANCE_RGB if degree is None else APPEARANCE_SH
    appearance = AppearanceOutput(color_name, space, degree, generator.color_space)
    return GeneratorManifest(
        name=name,
        family=generator.family,
        producer=generator.producer or Producer(f"gsgen {version('gsgen')}"),
        inputs=tuple(generator.inputs),
        outputs=GeneratorOutputs(
            GaussiansOutput(GAUSSIANS, capacity, dtype), appearance, CountOutput(COUNT)
        ),
        space=generator.space,
        bounds=bounds,
        depends_on=dict(generator.depends_on),
        antialias=generator.antialias,
        tolerances=_TOLERANCES,
    )


def _probes(manifest: GeneratorManifest) -> tuple[Probe, ...]:
    shapes = {entry.name: entry.shape or () for entry in manifest.inputs}
    dtypes = {entry.name: ROLES[entry.role].dtype[0] for entry in manifest.inputs}
    return default_probes(manifest, shapes, dtypes)


def _check_parity(
    path: Path, manifest: GeneratorManifest, references: list[Reference], progress: Progress
) -> Parity:
    progress(f"comparing with eager torch at {len(references)} probes")
    appearance = manifest.outputs.appearance
    assert appearance is not None
    names = (GAUSSIANS, appearance.name, COUNT)
    probes = [reference.probe for reference in references]
    limits = Limits().for_model(path.stat().st_size)
    with execute(path, names, probes, limits) as execution:
        if execution.fault is not None:
            what = f"ONNX Runtime cannot run the exported model: {execution.fault.message}"
            raise ParityFailed(what, where=path.name)
        samples = [execution.samples[run.sample].outputs for run in execution.runs]
        outputs = [(s[names[0]], s[names[1]], int(np.ravel(s[COUNT])[0])) for s in samples]
        parity = compare(references, outputs, manifest.tolerances or _TOLERANCES)
    if not parity.holds:
        worst = max(parity.fields, key=lambda field: field.excess)
        raise ParityFailed(
            f"{worst.field} of Gaussian {worst.row} is off by {worst.error:.3g} at probe "
            f"{worst.probe!r}, {worst.excess:.3g} times what is allowed ({parity.describe()})",
            where=path.name,
            mend="A value was turned into a constant while tracing: look for numpy round trips, "
            "`.item()`, Python branches on tensors, and buffers changed in forward.",
        )
    return parity


def _check_contract(
    path: Path, target: str, settings: Settings | None, progress: Progress
) -> Report:
    base = settings or Settings(level=Level.BEHAVIOUR)
    report = validate(path, replace(base, target=load_target(target)), progress=progress)
    if report.verdict != "conforms":
        broken = [
            finding for finding in report.findings if finding.severity >= Severity.ERROR
        ]
        listed = "; ".join(
            f"{f.rule} {f.where}: {f.message}" for f in broken or report.findings
        )
        mend = (broken or report.findings)[0].mend if report.findings else ""
        raise ExportRejected(listed, report, where=path.name, mend=mend)
    return report

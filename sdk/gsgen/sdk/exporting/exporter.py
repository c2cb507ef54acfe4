"""Export a generator: trace it, finish the graph, validate the file, compare it with torch.

The file appears at its place only if all of that succeeded.
"""

__all__ = ["Exported", "Progress", "export"]

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CellsOutput,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Producer,
    Tolerances,
)
from gsgen.contract.spec.roles import ROLES
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.module_checks import validate_module
from gsgen.sdk.authoring.packed_module import (
    APPEARANCE_RGB,
    APPEARANCE_SH,
    CELLS,
    COUNT,
    GAUSSIANS,
    Packed,
    PackedGenerator,
    refuse_parts,
)
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.exporting.eager_reference import (
    Reference,
    measure_bounds,
    run_eager,
    run_watched,
)
from gsgen.sdk.exporting.embed_manifest import finish
from gsgen.sdk.exporting.parity_diagnosis import Suspects
from gsgen.sdk.exporting.sh_padding import filled_harmonics
from gsgen.sdk.exporting.trace_hazards import Watch
from gsgen.sdk.exporting.tracing import trace
from gsgen.sdk.exporting.verification import check_contract, check_memory, check_parity
from gsgen.sdk.float16.convert_model import Float16Result, half_manifest, to_float16
from gsgen.sdk.parity import Parity
from gsgen.sdk.rewriting.atomic_model_files import atomic_write, refuse_folder
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.rewriting.rewrite import Change, prepare

Dtype = Literal["float32", "float16"]
Progress = Callable[[str], None]

OPSET = 18
# Where cameras stand in probes of our own, as a share of the distance of the contract's.
_DISTANCES = {"close": 0.2, "far": 8.0}
_TOLERANCES = Tolerances()
# What may be off where weights are float16; see _HALF_ROUNDINGS for what storing outputs adds. It is
# measured at few probes: at others, covariances were seen to be off by four times as much.
_HALF_CHOICE = Tolerances(position=1e-2, covariance=1e-3, opacity=1e-4, appearance=5e-4)
# How often it rounds as much as storing the outputs does.
_HALF_ROUNDINGS = 3
# The same at all probes, also those that the choice was not made at.
_HALF_SLACK = Tolerances(position=2e-2, covariance=8e-3, opacity=1e-3, appearance=1e-3)
# Choices that may be measured while exporting, and at how many probes; the command `gsgen float16`
# takes more time. The model that results is compared at all of them.
_HALF_BUDGET, _HALF_PROBES = 24, 4


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
        halved: What became float16, where outputs did.
        notes: What else a user may want to know of it.
    """

    path: Path
    manifest: GeneratorManifest
    parity: Parity
    report: Report
    changes: tuple[Change, ...] = ()
    halved: Float16Result | None = None
    notes: tuple[str, ...] = ()

    @property
    def contents(self) -> str:
        """What the model gives, in a few words."""
        gaussians = self.manifest.outputs.gaussians
        assert gaussians is not None
        return f"{gaussians.capacity:,} rows, {gaussians.dtype}"


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
        generator: The module; it is put into evaluation mode and moved to the CPU.
        path: Where the model goes; it is replaced only by a model that passed every check.
        name: What people call it; the file's stem where absent.
        dtype: Of all outputs but the count; float16 stores weights in 16 bits, too, wherever that
            does not show; arithmetic stays float32 (:mod:`gsgen.sdk.float16.convert_model`).
        capacity: Rows of the outputs; as many as there are Gaussians where absent.
        opset: ONNX operator set, 18 being the one that every runtime has kernels for.
        target: The consumer to rewrite and validate for.
        rewrite: Rewrite the graph so that it is captured; without, it stays as torch wrote it.
        settings: Limits and severities of that validation.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        GeneratorInvalid: The module declares or returns something the contract does not know.
        ExportFailed: Torch could not export it.
        RewriteFailed: It cannot be halved.
        ParityFailed: The model computes something else than the module.
        ExportRejected: The model breaks a rule; the error carries the report.
    """
    path = Path(path)
    refuse_folder(path)
    validate_module(generator)
    generator = generator.eval().cpu()
    wanted = _Wanted(name or path.stem, dtype, capacity, opset, target, rewrite)
    with filled_harmonics(generator, half=dtype == "float16", target=target) as notes:
        made = _export(generator, path, wanted, settings, progress)
        return replace(made, notes=tuple(notes))


@dataclass(frozen=True, slots=True)
class _Wanted:
    """Options of :func:`export`."""

    name: str
    dtype: Dtype
    capacity: int | None
    opset: int
    target: str
    rewrite: bool


def _export(
    generator: GaussianGenerator,
    path: Path,
    wanted: _Wanted,
    settings: Settings | None,
    progress: Progress,
) -> Exported:
    progress("running the module in eager torch")
    # Halving is left to the rewrite, which measures what has to stay float32.
    halves = wanted.dtype == "float16" and wanted.rewrite
    traced: Dtype = "float32" if halves else wanted.dtype
    described = _describe(generator, wanted.name, traced, wanted.capacity)
    manifest, references = described.manifest, described.references
    gaussians = manifest.outputs.gaussians
    assert gaussians is not None
    packed = PackedGenerator(generator, Packed(getattr(torch, traced), gaussians.capacity))
    progress("tracing the graph")
    example, hazards = described.example, described.watch.hazards
    model = trace(packed, example, manifest, wanted.opset, hazards)
    progress("rewriting the graph")
    changes = finish(model, manifest, load_target(wanted.target), rewrite=wanted.rewrite)
    halved = None
    if halves:
        prepare(model)
        every = max(1, len(references) // _HALF_PROBES)
        probes = [one.probe for one in references[::every]][:_HALF_PROBES]
        model, halved = to_float16(
            model,
            manifest,
            probes,
            tolerances=_HALF_CHOICE,
            arithmetic=False,
            roundings=_HALF_ROUNDINGS,
            budget=_HALF_BUDGET,
            progress=progress,
        )
        manifest = half_manifest(manifest)
    with atomic_write(path) as draft:
        save_model(model, draft)
        suspects = Suspects(generator, example, hazards, wanted.rewrite)
        slack = (_HALF_SLACK, _HALF_ROUNDINGS) if halves else (None, 1)
        parity = check_parity(draft, manifest, references, suspects, progress, *slack)
        check_memory(generator, described.watch, references)
        report = check_contract(draft, path, wanted.target, settings, progress)
    return Exported(path, manifest, parity, report, tuple(changes), halved)


@dataclass(frozen=True, slots=True)
class _Described:
    """What a module declares and does.

    Attributes:
        manifest: As it will be embedded.
        references: What eager torch gives: at the contract's probes, and far from them.
        example: The inputs to trace with.
        watch: What was seen in the first run.
    """

    manifest: GeneratorManifest
    references: list[Reference]
    example: Probe
    watch: Watch


def _describe(
    generator: GaussianGenerator, name: str, dtype: Dtype, capacity: int | None
) -> _Described:
    """Build the manifest from what the module declares and what it emits."""
    _check_inputs(generator)
    draft = _manifest(generator, name, dtype, None, 1, None)
    one, *others = _probes(draft)
    start, watch = run_watched(generator, one)
    _check_cells(generator, start)
    first = [start, *(run_eager(generator, probe) for probe in others)]
    made = start.gaussians
    rows = capacity if capacity is not None else len(made)
    if rows < len(made):
        raise GeneratorInvalid(
            f"capacity {rows} is less than the {len(made)} Gaussians",
            where="capacity",
            hint=f"Give {len(made)} or more.",
        )
    bounds = measure_bounds(first)
    draft = _manifest(generator, name, dtype, made.degree, rows, bounds)
    if start.cells is not None:
        per_cell = len(made) // len(start.cells)
        refuse_parts(rows, per_cell)
        cells = CellsOutput(CELLS, per_cell, dtype)
        draft = replace(draft, outputs=replace(draft.outputs, cells=cells))
    if not generator.inputs:
        return _Described(draft, first, one, watch)
    # Cameras orbit the bounds, so probes are laid out again around the measured ones.
    references = [run_eager(generator, probe) for probe in _probes(draft)]
    manifest = replace(draft, bounds=measure_bounds(first + references))
    far = [run_eager(generator, probe) for probe in _far_probes(manifest)]
    return _Described(manifest, [*references, *far], references[1].probe, watch)


def _check_inputs(generator: GaussianGenerator) -> None:
    names = [entry.name for entry in generator.inputs]
    where = f"{type(generator).__name__}.inputs"
    for entry in generator.inputs:
        if names.count(entry.name) > 1:
            hint = "Give each input a name of its own."
            raise GeneratorInvalid(f"{entry.name!r} stands twice", where=where, hint=hint)
        if entry.shape is None:
            hint = "Make inputs with the functions of gsgen.sdk.authoring.inputs."
            raise GeneratorInvalid(f"{entry.name!r} has no shape", where=where, hint=hint)


def _check_cells(generator: GaussianGenerator, made: Reference) -> None:
    if (made.cells is None) == (generator.weighted_sum is None):
        return
    where = type(generator).__name__
    if made.cells is None:
        what = "weighted_sum is set, but forward returns no cells to sum by"
        hint = "Return Gaussians(…, cells=Cells(…)), or leave weighted_sum out."
    else:
        what = "forward returns cells, but nothing says how to weigh what is in them"
        hint = "Set weighted_sum = WeightedSum(background=…)."
    raise GeneratorInvalid(what, where=where, hint=hint)


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
            GaussiansOutput(GAUSSIANS, capacity, dtype),
            appearance,
            CountOutput(COUNT, generator.count_semantics),
        ),
        space=generator.space,
        bounds=bounds,
        depends_on=dict(generator.depends_on),
        antialias=generator.antialias,
        blend="alpha" if generator.weighted_sum is None else "wsr",
        weighted_sum=generator.weighted_sum,
        tolerances=_TOLERANCES,
    )


def _probes(
    manifest: GeneratorManifest, *, seed: int = 0, count: int = 8
) -> tuple[Probe, ...]:
    shapes = {entry.name: entry.shape or () for entry in manifest.inputs}
    dtypes = {entry.name: ROLES[entry.role].dtype[0] for entry in manifest.inputs}
    return default_probes(manifest, shapes, dtypes, seed, count)


def _far_probes(manifest: GeneratorManifest) -> Iterator[Probe]:
    """Yield probes far from those a model is traced with and judged by.

    Cameras stand within the scene and far outside of it, and all else is sampled anew.
    """
    assert manifest.bounds is not None
    for seed, (label, scale) in enumerate(_DISTANCES.items(), start=1):
        low, high = np.array([manifest.bounds.min, manifest.bounds.max])
        middle, half = (low + high) / 2, (high - low) / 2
        scaled = Bounds(
            tuple((middle - scale * half).tolist()), tuple((middle + scale * half).tolist())
        )
        moved = replace(manifest, bounds=scaled)
        for probe in _probes(moved, seed=seed, count=2)[1:]:
            yield replace(probe, label=f"{label}, {probe.label}")

"""Exports a torch generator to ONNX: runs it, traces, rewrites, verifies and validates it."""

__all__ = ["Exported", "export"]

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
import onnx_ir as ir
import torch

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.probing.test_vectors import MOST_RECORDED
from gsgen.contract.process.atomic_files import refuse_folder
from gsgen.contract.spec.fields.roles import ROLES
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CellsOutput,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Producer,
    ReferenceImage,
    TestVector,
    Tolerances,
)
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.module_checks import validate_module
from gsgen.sdk.authoring.output_names import APPEARANCE_RGB, APPEARANCE_SH, CELLS, COUNT, GAUSSIANS
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator, check_whole_cells
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.exporting.eager_reference import (
    EagerRuns,
    Reference,
    measure_bounds,
    packed_outputs,
    run_eager,
    run_watched,
)
from gsgen.sdk.exporting.embed_manifest import rewrite_and_embed
from gsgen.sdk.exporting.frame_size import check_fits, describe_size
from gsgen.sdk.exporting.parity_diagnosis import Suspects
from gsgen.sdk.exporting.pipeline import (
    OPSET,
    VECTORS,
    Dtype,
    ExportResult,
    Progress,
    silent,
    write_export,
)
from gsgen.sdk.exporting.sh_degrees import HALF_RGB
from gsgen.sdk.exporting.sh_padding import padded_harmonics
from gsgen.sdk.exporting.source_vectors import RowRecorder, add_source_vectors
from gsgen.sdk.exporting.tracing.autocast import float32_arithmetic
from gsgen.sdk.exporting.tracing.hazards import Watch
from gsgen.sdk.exporting.tracing.trace import trace_generator
from gsgen.sdk.exporting.verification import check_memory, check_parity
from gsgen.sdk.float16.convert_model import Float16Result, float16_manifest, to_float16
from gsgen.sdk.parity import Parity
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.rewriting.rewrite import prepare
from gsgen.sdk.source_pictures import add_source_pictures

# Distances of the cameras of the SDK's own probes, as a share of those of the contract's probes.
_DISTANCES = {"close": 0.2, "far": 8.0}
_TOLERANCES = Tolerances()
# Probes besides the all-zero one: of the measured bounds, and of the quick comparison.
_BOUNDS_PROBES, _QUICK_PROBES = 8, 2
# Tolerances of the search for weights that may be float16; _HALF_ROUNDINGS adds the rounding of
# stored outputs. The search measures few probes: at others, covariances were four times as far off.
_HALF_CHOICE = Tolerances(position=1e-2, covariance=1e-3, opacity=1e-4, appearance=5e-4)
# How often the rounding of stored outputs is added to the tolerances.
_HALF_ROUNDINGS = 3
# Tolerances of the final comparison, at all probes, including those that the search did not use.
_HALF_SLACK = Tolerances(position=2e-2, covariance=8e-3, opacity=1e-3, appearance=1e-3)
# Measurements and probes of the search during an export; the command `gsgen float16` takes more.
_HALF_BUDGET, _HALF_PROBES = 24, 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported(ExportResult):
    """The result of exporting a torch generator to ONNX.

    Attributes:
        manifest: The embedded manifest.
        parity: How closely the model agrees with eager torch.
        halved: Which nodes and weights became float16; None if the outputs are float32.
    """

    manifest: GeneratorManifest
    parity: Parity
    halved: Float16Result | None = None

    @property
    def dtype(self) -> Dtype:
        """The dtype of the packed Gaussians."""
        assert self.manifest.outputs.gaussians is not None
        return self.manifest.outputs.gaussians.dtype

    @property
    def contents(self) -> str:
        """A short description of the exported model: number of Gaussians and their dtype."""
        assert self.manifest.outputs.gaussians is not None
        return f"{self.manifest.outputs.gaussians.capacity:,} rows, {self.dtype}"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options:
    name: str
    dtype: Dtype
    capacity: int | None
    opset: int
    target: str
    rewrite: bool
    pictures: int  # reference pictures of the eager module
    vectors: int  # test vectors with rows of the eager module
    compared: int  # probes of the comparison with eager torch, besides the all-zero one

    @property
    def searches_float16(self) -> bool:
        """Whether a search over rounding errors decides which weights become float16."""
        return self.dtype == "float16" and self.rewrite


def export(
    generator: GaussianGenerator,
    path: str | os.PathLike[str],
    *,
    name: str | None = None,
    dtype: Dtype | None = None,
    capacity: int | None = None,
    opset: int = OPSET,
    target: str = "core",
    rewrite: bool = True,
    verify: Literal["quick", "full"] = "full",
    pictures: int = 0,
    vectors: int = VECTORS,
    settings: Settings | None = None,
    progress: Progress = silent,
) -> Exported:
    """Export a torch generator as an ONNX file that conforms and agrees with torch.

    Args:
        generator: The module; it is put into evaluation mode and moved to the CPU.
        path: The model file; it is replaced only by a model that passed every check.
        name: Name in the manifest; the file's stem if absent.
        dtype: The dtype of all outputs but the count. float16 stores weights in 16 bits, too, if
            the error is below the tolerance; arithmetic stays float32
            (:mod:`gsgen.sdk.float16.convert_model`). If absent, float32, or what the target reads
            if that is float16 alone.
        capacity: Rows of the outputs; as many as there are Gaussians if absent.
        opset: ONNX operator set; every runtime has kernels for 18.
        target: The consumer to rewrite and validate for.
        rewrite: Whether to rewrite the graph so that it is captured; if False, it stays as torch
            exported it.
        settings: Level, limits and severities of the validation.
        verify: How many probes are compared with eager torch: ``quick`` takes a third of them.
            Bounds are measured at all of them in either case.
        pictures: How many pictures of the eager module become reference images of the model, which
            level ``render`` compares with; the renderer draws them (``gsgen[runtime]``).
        vectors: How many test vectors with a few rows of the eager module the manifest gets, which
            level ``behaviour`` compares with; at most four. None are written if ``forward`` sorts,
            as equal keys may come in another order elsewhere.
        progress: Called with a message when a step begins.

    Raises:
        GeneratorInvalid: The module declares or returns something that the contract does not allow.
        ExportFailed: Torch could not export it.
        RewriteFailed: It cannot be converted to float16.
        ParityFailed: The model computes something else than the module.
        ExportRejected: The model breaks a rule; the error carries the report.
        ConfigInvalid: ``vectors`` or ``pictures`` is out of range.
    """
    path = Path(path)
    refuse_folder(path)
    if not 0 <= vectors <= MOST_RECORDED:
        message = f"is {vectors}, expected from 0 to {MOST_RECORDED}"
        raise ConfigInvalid(message, where="vectors", hint="Give 0 to record no rows.")
    validate_module(generator, GaussianGenerator)
    generator = generator.eval().cpu()
    options = _Options(
        name=name or path.stem,
        dtype=dtype or _default_dtype(generator, target),
        capacity=capacity,
        opset=opset,
        target=target,
        rewrite=rewrite,
        pictures=pictures,
        vectors=vectors,
        compared=_BOUNDS_PROBES if verify == "full" else _QUICK_PROBES,
    )
    half = options.dtype == "float16"
    with padded_harmonics(generator, half=half, target=target) as notes, float32_arithmetic(notes):
        exported = _export(generator, path, options, settings, progress)
        return replace(exported, notes=tuple(notes))


def _export(
    generator: GaussianGenerator,
    path: Path,
    options: _Options,
    settings: Settings | None,
    progress: Progress,
) -> Exported:
    # Steps 1 and 2: eager reference and hazards.
    progress("running the module in eager torch")
    searches = options.searches_float16
    # The search needs a float32 graph, whose rounding it can measure.
    traced_dtype: Dtype = "float32" if searches else options.dtype
    described = _describe(generator, options, traced_dtype, progress)
    manifest, references = described.manifest, described.references
    gaussians = manifest.outputs.gaussians
    assert gaussians is not None
    # Step 3: tracing.
    storage = Packed(getattr(torch, traced_dtype), gaussians.capacity)
    progress("tracing the graph")
    example, hazards = described.example, described.watch.hazards
    packed = PackedGenerator(generator, storage)
    model = trace_generator(packed, example, manifest, options.opset, hazards)
    # Steps 4 and 5: rewriting and manifest.
    progress("rewriting the graph")
    target = load_target(options.target)
    changes = rewrite_and_embed(model, manifest, target, rewrite=options.rewrite)
    halved = None
    if searches:
        model, halved = _in_float16(model, described, progress)
        manifest = float16_manifest(manifest)
    suspects = Suspects(generator, example, hazards, options.rewrite)

    images: list[ReferenceImage] = []
    recorded: list[TestVector] = []
    recorder = _row_recorder(described, options)

    def run_packed(probe: Probe) -> dict[str, np.ndarray]:
        return packed_outputs(run_eager(generator, probe), manifest)

    # Step 6: verification, rows and pictures of the module.
    def verify(draft: Path) -> Parity:
        slack = (_HALF_SLACK, _HALF_ROUNDINGS) if searches else (None, 1)
        parity = check_parity(
            draft, manifest, references, suspects, progress, *slack, observe=recorder.observe
        )
        check_memory(generator, described.watch, references)
        recorded.extend(add_source_vectors(draft, recorder, slack[0]))
        if options.pictures:
            progress("drawing the module in eager torch")
            images.extend(add_source_pictures(draft, run_packed, options.pictures))
        return parity

    # Steps 7 and 8: validation and atomic write.
    parity, report = write_export(
        path,
        lambda draft: save_model(model, draft),
        verify,
        target=options.target,
        settings=settings,
        progress=progress,
    )
    return Exported(
        path=path,
        manifest=replace(manifest, reference_images=tuple(images), test_vectors=tuple(recorded)),
        parity=parity,
        report=report,
        changes=tuple(changes),
        halved=halved,
    )


def _in_float16(
    model: ir.Model, described: "_Description", progress: Progress
) -> tuple[ir.Model, Float16Result]:
    """Return a traced model with weights and outputs in float16, where the error is allowed."""
    prepare(model)
    stride = max(1, len(described.references) // _HALF_PROBES)
    return to_float16(
        model,
        described.manifest,
        described.references.probes[::stride][:_HALF_PROBES],
        tolerances=_HALF_CHOICE,
        arithmetic=False,
        roundings=_HALF_ROUNDINGS,
        budget=_HALF_BUDGET,
        progress=progress,
    )


def _row_recorder(described: "_Description", options: _Options) -> RowRecorder:
    """Return a recorder of test vectors, which records none if the torch module sorts rows."""
    # Probe 0 is all zeros; those after the compared ones are the SDK's own.
    candidates = range(min(options.compared + 1, len(described.references)))
    is_sorting = any(hazard.kind == "order" for hazard in described.watch.hazards)
    return RowRecorder(described.references, candidates, 0 if is_sorting else options.vectors)


def _default_dtype(generator: GaussianGenerator, target: str) -> Dtype:
    """Return the default output dtype: float32, unless the target viewer reads RGB as float16."""
    if target not in HALF_RGB:
        return "float32"
    probe = _probes(_manifest(generator, "", "float32", None, 1, None))[0]
    return "float32" if run_eager(generator, probe).gaussians.rgb is None else "float16"


@dataclass(frozen=True, slots=True)
class _Description:
    """The declarations of a torch generator, and the results of its runs in eager torch."""

    manifest: GeneratorManifest  # the manifest to embed
    references: EagerRuns  # results at the contract's probes, and at probes far from them
    example: Probe  # the inputs to trace with
    watch: Watch  # the hazards of the first run


def _describe(
    generator: GaussianGenerator, options: _Options, dtype: Dtype, progress: Progress
) -> _Description:
    """Build a torch generator's manifest from its declarations and its outputs in eager torch."""
    _check_inputs(generator)
    # The bounds are not known yet, so the first probes lie around the default bounds.
    draft = _manifest(generator, options.name, dtype, None, 1, None)
    first_probes = _probes(draft)
    started = time.perf_counter()
    start, watch = run_watched(generator, first_probes[0])
    seconds = time.perf_counter() - started
    _check_cells(generator, start)
    gaussians = start.gaussians
    rows = options.capacity if options.capacity is not None else len(gaussians)
    if rows < len(gaussians):
        message = f"capacity {rows} is less than the {len(gaussians)} Gaussians"
        hint = f"Give {len(gaussians)} or more."
        raise GeneratorInvalid(message, where="capacity", hint=hint)
    draft = _manifest(generator, options.name, dtype, gaussians.degree, rows, None)
    stored = float16_manifest(draft) if options.searches_float16 else draft
    check_fits(generator, stored, options.target)
    if size := describe_size(
        stored, seconds=seconds, runs=3 * _BOUNDS_PROBES + 2 * options.compared
    ):
        progress(size)
    first_runs = EagerRuns(generator, first_probes, [start])
    draft = replace(draft, bounds=measure_bounds(first_runs))
    if start.cells is not None:
        per_cell = len(gaussians) // len(start.cells)
        check_whole_cells(rows, per_cell)
        cells = CellsOutput(CELLS, per_cell, dtype)
        draft = replace(draft, outputs=replace(draft.outputs, cells=cells))
    if not generator.inputs:
        return _Description(draft, first_runs, first_probes[0], watch)
    # Cameras orbit the bounds, so they are placed a second time, around the measured bounds.
    placed = EagerRuns(generator, _probes(draft))
    references = first_runs if placed.has_inputs_of(first_runs) else placed
    manifest = replace(draft, bounds=measure_bounds(chain(first_runs, references)))
    # Bounds need every probe that the validator has; a quick comparison takes some of them.
    last = len(references) - 1
    compared = references.select(np.linspace(1, last, options.compared).round().astype(int))
    zeros = references.select([0])
    far = EagerRuns(generator, tuple(_far_probes(manifest)))
    return _Description(manifest, zeros + compared + far, references.probes[1], watch)


def _check_inputs(generator: GaussianGenerator) -> None:
    names = [entry.name for entry in generator.inputs]
    where = f"{type(generator).__name__}.inputs"
    for entry in generator.inputs:
        if names.count(entry.name) > 1:
            hint = "Give each input a name of its own."
            raise GeneratorInvalid(f"two inputs are named {entry.name!r}", where=where, hint=hint)
        if entry.shape is None:
            hint = "Make inputs with the functions of gsgen.sdk.inputs."
            raise GeneratorInvalid(f"input {entry.name!r} has no shape", where=where, hint=hint)


def _check_cells(generator: GaussianGenerator, reference: Reference) -> None:
    if (reference.cells is None) == (generator.weighted_sum is None):
        return
    if reference.cells is None:
        message = "weighted_sum is set, but forward returns no cells"
        hint = "Return Gaussians(…, cells=Cells(…)), or leave weighted_sum out."
    else:
        message = "forward returns cells, but weighted_sum is not set"
        hint = "Set weighted_sum = WeightedSum(background=…)."
    raise GeneratorInvalid(message, where=type(generator).__name__, hint=hint)


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
    color_range = generator.color_range if degree is None else None
    appearance = AppearanceOutput(
        color_name, space, degree, generator.color_space, range=color_range
    )
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
    manifest: GeneratorManifest, *, seed: int = 0, count: int = _BOUNDS_PROBES
) -> tuple[Probe, ...]:
    shapes = {entry.name: entry.shape or () for entry in manifest.inputs}
    dtypes = {entry.name: ROLES[entry.role].dtype[0] for entry in manifest.inputs}
    return default_probes(manifest, shapes, dtypes, seed, count)


def _far_probes(manifest: GeneratorManifest) -> Iterator[Probe]:
    """Yield test inputs with cameras inside the scene and far outside of it.

    All other inputs are sampled with another seed.
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

"""Exports a torch generator to ONNX: runs it, traces, rewrites, verifies and validates it."""

__all__ = ["export"]

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import onnx_ir as ir
import torch

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.test_vectors import MAX_RECORDED_VECTORS
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.process.interrupts import OutOfTime
from gsgen.contract.spec.manifest import GeneratorManifest, ReferenceImage, TestVector, Tolerances
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.module_checks import validate_module
from gsgen.sdk.authoring.on_cpu import on_cpu
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from gsgen.sdk.errors import ExportFailed, ExportRejected
from gsgen.sdk.exporting.eager_reference import packed_outputs, run_eager
from gsgen.sdk.exporting.embed_manifest import rewrite_and_embed
from gsgen.sdk.exporting.parity_diagnosis import ParitySuspects
from gsgen.sdk.exporting.pipeline import (
    OPSET,
    VECTOR_COUNT,
    Dtype,
    Exported,
    ExportOptions,
    Progress,
    StageClock,
    check_contract,
    no_progress,
)
from gsgen.sdk.exporting.prepare import BOUNDS_PROBES, PreparedExport, default_dtype, prepare_export
from gsgen.sdk.exporting.sh_padding import padded_harmonics
from gsgen.sdk.exporting.source_vectors import RowRecorder, add_source_vectors
from gsgen.sdk.exporting.tracing.autocast import float32_arithmetic
from gsgen.sdk.exporting.tracing.operator_watch import OperatorWatch
from gsgen.sdk.exporting.tracing.trace import TracedGenerator, trace_generator
from gsgen.sdk.exporting.verification import check_memory, check_parity
from gsgen.sdk.float16.convert_model import Float16Result, float16_manifest, to_float16
from gsgen.sdk.parity import Parity
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.rewriting.rewrite import Change, normalize_model
from gsgen.sdk.source_pictures import SourcePictures, add_source_pictures

# Compared probes of a quick comparison, besides the all-zero one.
_QUICK_PROBE_COUNT = 2
# Tolerances of the search for weights that may be float16; _HALF_ROUNDINGS adds the rounding of
# stored outputs. The search measures few probes: at others, covariances were four times as far off.
_FLOAT16_TOLERANCES = Tolerances(position=1e-2, covariance=1e-3, opacity=1e-4, appearance=5e-4)
# How often the rounding of stored outputs is added to the tolerances.
_HALF_ROUNDINGS = 3
# Tolerances of the final comparison, at all probes, including those that the search did not use.
_FLOAT16_SLACK = Tolerances(position=2e-2, covariance=8e-3, opacity=1e-3, appearance=1e-3)
# Measurements and probes of the search during an export; the command `gsgen float16` takes more.
_FLOAT16_RUN_BUDGET, _FLOAT16_PROBE_COUNT = 24, 4
# The rules that a shape which depends on values breaks.
_SHAPE_RULES = ("GG004", "GG026")
# The rule of the view matrix's order in memory.
_MATRIX_ORDER_RULE = "GI007"
_MATRIX_ORDER_HINT = (
    "The input of gsgen.sdk.inputs.view() has the transposed matrix, as 3DGS's world_view_transform: "
    "xyz @ camera[:3, :3] + camera[3, :3]. If forward reads it as xyz @ camera[:3, :3].T + "
    'camera[:3, 3], write space = Space(matrix_order="row") into the class.'
)


@dataclass(frozen=True, slots=True)
class _RewrittenModel:
    """A graph for the target, in the final dtype, with its manifest."""

    model: ir.Model
    manifest: GeneratorManifest
    changes: tuple[Change, ...]
    float16_result: Float16Result | None  # None if no search decided which weights become float16


@dataclass(frozen=True, slots=True)
class _VerificationResult:
    """What the comparison of a draft with its module gave."""

    parity: Parity
    vectors: tuple[TestVector, ...]  # rows of the module
    images: tuple[ReferenceImage, ...]  # pictures of the module
    notes: tuple[str, ...]  # on pictures that are missing


@on_cpu()
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
    skip: Sequence[str] = (),
    verify: Literal["quick", "full"] = "full",
    pictures: SourcePictures | None = None,
    vectors: int = VECTOR_COUNT,
    samples: Sequence[Mapping[str, np.ndarray]] = (),
    settings: Settings | None = None,
    progress: Progress = no_progress,
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
        skip: Names of passes to leave out of the rewriting; ``gsgen rewrite --list`` has them.
        settings: Level, limits and severities of the validation.
        verify: How many probes are compared with eager torch: ``quick`` takes a third of them.
            Bounds are measured at all of them in either case.
        pictures: How many pictures of the eager module become reference images of the model, which
            level ``render`` compares with, and what draws them; none if absent.
        vectors: How many test vectors with a few rows of the eager module the manifest gets, which
            level ``behaviour`` compares with; at most four. None are written if ``forward`` sorts,
            as equal keys may come in another order elsewhere.
        samples: Inputs to compare at besides the contract's probes, by name: such as poses of the
            training data, where random ones are far from all that the module knows.
        progress: Called with a message when a step begins.

    Raises:
        GeneratorInvalid: The module declares or returns something that the contract does not allow.
        ExportFailed: Torch could not export it.
        RewriteFailed: It cannot be converted to float16.
        ParityFailed: The model computes something else than the module.
        ExportRejected: The model breaks a rule; the error carries the report.
        ConfigInvalid: ``vectors`` or ``pictures`` is out of range, or ``samples`` are not inputs.
    """
    path = Path(path)
    options = ExportOptions(
        path=path,
        name=name or path.stem,
        opset=opset,
        target=target,
        settings=settings,
        progress=progress,
        rewrite=rewrite,
        skip=skip,
    )
    if not 0 <= vectors <= MAX_RECORDED_VECTORS:
        message = f"is {vectors}, expected from 0 to {MAX_RECORDED_VECTORS}"
        raise ConfigInvalid(message, where="vectors", hint="Give 0 to record no rows.")
    validate_module(generator, GaussianGenerator)
    generator = generator.eval().cpu()
    dtype = dtype or default_dtype(generator, target)
    half = dtype == "float16"
    clock = StageClock.of(progress)
    with padded_harmonics(generator, half=half, target=target) as notes, float32_arithmetic(notes):
        # Step 1: eager reference and hazards. A search for float16 weights measures a float32 graph.
        clock.begin("running the module in eager torch")
        prepared_export = prepare_export(
            generator,
            options,
            dtype="float32" if rewrite else dtype,
            stored_dtype=dtype,
            capacity=capacity,
            compared=BOUNDS_PROBES if verify == "full" else _QUICK_PROBE_COUNT,
            samples=samples,
        )
        # Steps 2 to 4: tracing, rewriting and manifest.
        clock.begin("tracing the graph")
        traced = _trace(prepared_export, options)
        clock.begin("rewriting the graph")
        rewritten = _rewrite_for_target(traced.model, prepared_export, options, half=half)
        # Steps 5 to 7: verification, validation and atomic write.
        with atomic_write(path) as draft:
            save_model(rewritten.model, draft)
            clock.begin("comparing with eager torch")
            verification_result = _verify_exported_model(
                draft, prepared_export, rewritten, options, vectors, pictures
            )
            clock.begin("validating the model")
            try:
                report = check_contract(draft, options)
            except ExportRejected as error:
                raise _with_line(error, traced.shape_obstacle, prepared_export) from error
    notes += verification_result.notes
    if traced.folding is not None:
        notes += traced.folding.describe()
    gaussians = rewritten.manifest.outputs.gaussians
    assert gaussians is not None
    return Exported(
        path=path,
        manifest=replace(
            rewritten.manifest,
            reference_images=verification_result.images,
            test_vectors=verification_result.vectors,
        ),
        report=report,
        dtype=dtype,
        contents=f"{gaussians.capacity:,} rows, {dtype}",
        parity=verification_result.parity,
        changes=rewritten.changes,
        notes=tuple(notes),
        float16_result=rewritten.float16_result,
        stages=clock.stages(),
        folded=None if traced.folding is None else traced.folding.counts,
    )


def _with_line(
    error: ExportRejected, obstacle: ExportFailed | None, prepared_export: PreparedExport
) -> ExportRejected:
    """Return a rejection with the line of forward: of a shape, or of the view matrix's order."""
    rules = {finding.rule for finding in error.report.findings}
    if obstacle is not None and not rules.isdisjoint(_SHAPE_RULES):
        return ExportRejected(error.message, error.report, where=obstacle.where, hint=obstacle.hint)
    if _MATRIX_ORDER_RULE in rules:
        where = _line_that_reads_view(prepared_export) or error.where
        return ExportRejected(error.message, error.report, where=where, hint=_MATRIX_ORDER_HINT)
    return error


def _line_that_reads_view(prepared_export: PreparedExport) -> str:
    """Return the line of forward that first reads the view matrix; empty if it is not known."""
    manifest, example = prepared_export.manifest, prepared_export.example
    name = next(entry.name for entry in manifest.inputs if entry.role == "view")
    tensors = {name: torch.from_numpy(np.array(value)) for name, value in example.inputs.items()}
    with torch.no_grad(), OperatorWatch(tensors[name]) as watch:
        prepared_export.generator(*tensors.values())
    return watch.reading_line


def _trace(prepared_export: PreparedExport, options: ExportOptions) -> TracedGenerator:
    gaussians = prepared_export.manifest.outputs.gaussians
    assert gaussians is not None
    storage = Packed(getattr(torch, gaussians.dtype), gaussians.capacity)
    packed = PackedGenerator(prepared_export.generator, storage)
    hazards = prepared_export.watch.hazards
    return trace_generator(
        packed, prepared_export.example, prepared_export.manifest, options.opset, hazards
    )


def _rewrite_for_target(
    model: ir.Model, prepared_export: PreparedExport, options: ExportOptions, *, half: bool
) -> _RewrittenModel:
    """Rewrite a traced graph for the target; with ``half``, store weights and outputs in float16."""
    manifest, references = prepared_export.manifest, prepared_export.references
    target = load_target(options.target)
    changes = tuple(
        rewrite_and_embed(model, manifest, target, rewrite=options.rewrite, skip=options.skip)
    )
    if not (half and options.rewrite):
        return _RewrittenModel(model, manifest, changes, None)
    normalize_model(model)
    stride = max(1, len(references) // _FLOAT16_PROBE_COUNT)
    model, float16_result = to_float16(
        model,
        manifest,
        references.probes[::stride][:_FLOAT16_PROBE_COUNT],
        tolerances=_FLOAT16_TOLERANCES,
        arithmetic=False,
        roundings=_HALF_ROUNDINGS,
        budget=_FLOAT16_RUN_BUDGET,
        progress=options.progress,
    )
    return _RewrittenModel(model, float16_manifest(manifest), changes, float16_result)


def _verify_exported_model(
    draft: Path,
    prepared_export: PreparedExport,
    rewritten: _RewrittenModel,
    options: ExportOptions,
    vectors: int,
    pictures: SourcePictures | None,
) -> _VerificationResult:
    """Compare a draft with its module, and record rows and pictures of the module in it."""
    generator, manifest, watch = (
        prepared_export.generator,
        rewritten.manifest,
        prepared_export.watch,
    )
    suspects = ParitySuspects(generator, prepared_export.example, watch.hazards, options.rewrite)
    is_sorting = any(hazard.kind == "order" for hazard in watch.hazards)
    recorder = RowRecorder(
        prepared_export.references, prepared_export.recordable, 0 if is_sorting else vectors
    )
    slack, roundings = (
        (None, 1) if rewritten.float16_result is None else (_FLOAT16_SLACK, _HALF_ROUNDINGS)
    )
    parity = check_parity(
        draft, manifest, prepared_export.references, suspects, options, recorder, slack, roundings
    )
    check_memory(generator, watch, prepared_export.references)
    recorded_vectors = add_source_vectors(draft, recorder, slack)

    def run_packed(probe: Probe) -> Mapping[str, np.ndarray]:
        return packed_outputs(run_eager(generator, probe), manifest)

    images: tuple[ReferenceImage, ...] = ()
    notes: tuple[str, ...] = ()
    if pictures is not None:
        try:
            options.progress("drawing the module in eager torch")
            images = add_source_pictures(draft, run_packed, pictures)
        except OutOfTime as error:  # the model agrees with torch, and is written without pictures
            error.guard.cancel()
            notes = (f"--pictures: no picture was drawn: {error}",)
    return _VerificationResult(parity, recorded_vectors, images, notes)

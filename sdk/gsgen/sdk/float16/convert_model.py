"""Convert a model to float16, and keep in float32 what would show: measured, not listed by name.

Every node is rounded on its own and in groups, at the contract's probes, and the outputs are
compared with those of float32 in the contract's units: positions in standard deviations of their
Gaussian, covariances relative to their trace, opacity absolutely, appearance from 64 directions.
Tables are stored in 16 bits a number, whatever computes with them, unless even that would show.
"""

__all__ = ["Float16Result", "half_manifest", "to_float16", "write_float16"]

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import onnx_ir as ir

from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import MANIFEST_KEY, open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import GeneratorManifest, Tolerances
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.targets import load_target
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.float16.error_measure import ErrorProbe
from gsgen.sdk.float16.precision_policy import (
    Kept,
    choose_tables,
    epsilon_guards,
    explain,
    merge_islands,
)
from gsgen.sdk.float16.sensitivity_search import max_quantizable
from gsgen.sdk.float16.to_float16 import Boundary, ToFloat16, halves, key_of
from gsgen.sdk.parity import Parity
from gsgen.sdk.passes.framework.base import opset_of
from gsgen.sdk.passes.repairs import PadColor
from gsgen.sdk.rewriting.atomic_model_files import atomic_write
from gsgen.sdk.rewriting.constant_subgraph import constant_nodes
from gsgen.sdk.rewriting.model_io import (
    has_external_weights,
    refuse_overwriting,
    save_model,
    weight_bytes,
)
from gsgen.sdk.rewriting.output_equivalence import probes_of
from gsgen.sdk.rewriting.rewrite import prepare, tidy

_BUDGET = 200
# How much of what is allowed may be used up by storing weights, whatever is computed with them.
_SHARE_OF_WEIGHTS, _SHARE_WITHOUT_NODES = 0.5, 0.6
# How much of the tolerance the search may use, from one attempt to the next: what the real kernels
# add to the measured rounding is seen only at the end.
_SHARES = (1.0, 0.5, 0.25)

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Float16Result:
    """A finished conversion.

    Attributes:
        path: The file; None where none was written.
        halved: How many nodes compute in float16.
        kept: Which do not, although they could.
        casts: How many Casts stand between.
        parity: The final model against the one it came from, field by field.
        bytes_before: Of weights.
        bytes_after: Of weights.
        outputs_before: Bytes of outputs a frame.
        outputs_after: Bytes of outputs a frame.
        measured: How many choices were measured.
        kept_weights: Which tables are stored in float32, and the field that would show 16 bits.
    """

    path: Path | None
    halved: int
    kept: tuple[Kept, ...]
    casts: int
    parity: Parity
    bytes_before: int
    bytes_after: int
    outputs_before: int
    outputs_after: int
    measured: int
    kept_weights: tuple[Kept, ...] = ()


def write_float16(
    source: Path,
    path: Path | None,
    *,
    outputs: bool = True,
    tolerances: Tolerances | None = None,
    budget: int = _BUDGET,
    limits: Limits | None = None,
    progress: Progress = lambda _: None,
) -> Float16Result:
    """Write ``source`` in float16 to ``path``.

    Args:
        source: A Gaussian Generator with a manifest, in float32.
        path: Where the result goes; None measures, and writes nothing.
        outputs: Whether the outputs become float16, too.
        tolerances: What may differ; what the manifest declares, or the contract's own, where absent.
        budget: How many choices of nodes may be measured.
        limits: What running the result may use.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        ModelUnreadable: ``source`` is no model.
        ConfigInvalid: ``path`` would replace the weights of ``source``.
        RewriteFailed: It has no manifest, is float16 already, has SH whose float16 rows
            would not fill words, or no choice keeps the tolerances.
    """
    limits = limits or Limits()
    subject = inspect_model(open_model(source), load_target("core"), limits)
    if path is not None:
        refuse_overwriting(subject.file, path)
    manifest = subject.parsed.manifest if subject.parsed is not None else None
    if not isinstance(manifest, GeneratorManifest) or manifest.outputs.gaussians is None:
        raise RewriteFailed(
            "has no manifest of a Gaussian Generator, so errors have no units",
            where=str(source),
            hint="Derive one with `gsgen inspect MODEL --emit-manifest` and embed it with "
            "`gsgen fix`.",
        )
    model = ir.load(source)
    beside = has_external_weights(model)
    prepare(model)
    probes = probes_of(subject, {})
    converted, made = to_float16(
        model,
        manifest,
        probes,
        outputs=outputs,
        tolerances=tolerances,
        budget=budget,
        limits=limits,
        progress=progress,
    )
    if path is not None:
        with atomic_write(path) as draft:
            save_model(converted, draft, beside=beside)
    return replace(made, path=path)


def to_float16(
    model: ir.Model,
    manifest: GeneratorManifest,
    probes: Sequence[Probe],
    *,
    outputs: bool = True,
    tolerances: Tolerances | None = None,
    arithmetic: bool = True,
    roundings: int = 1,
    budget: int = _BUDGET,
    limits: Limits | None = None,
    progress: Progress = lambda _: None,
) -> tuple[ir.Model, Float16Result]:
    """Return ``model`` converted, and how; see :func:`write_float16`.

    Without ``arithmetic``, weights are stored in 16 bits and outputs are float16, and every node
    computes in float32 as before. ``roundings``: how often what storing outputs rounds may be
    added to the tolerances.

    Raises:
        RewriteFailed: No choice of nodes keeps the tolerances.
    """
    allowed = tolerances or manifest.tolerances or Tolerances()
    if outputs:
        _refuse_half_words(model, manifest)
    progress("running the model in float32")
    measure = ErrorProbe(model, manifest, probes, allowed, outputs, roundings)
    before, frame = weight_bytes(model), measure.frame_bytes
    opset = opset_of(model)
    once = set(constant_nodes(model.graph))
    nodes = [n for n in model.graph if n not in once and halves(n, opset)]
    boundary = Boundary(model.graph, opset)
    if not nodes and not measure.weights:
        raise RewriteFailed("computes nothing in float32", where="model")
    if not measure.rounded.holds:
        raise RewriteFailed(
            f"float16 outputs alone are too coarse: {measure.rounded.describe()}",
            where="outputs",
            hint="Keep them float32 (`gsgen float16 --keep-outputs`), or move the scene closer to "
            "its origin.",
        )
    guarded = epsilon_guards(nodes, opset)
    spent, result = 0, None
    for share in _SHARES:
        # Tables come first: they are what is stored, loaded and sent.
        progress(f"measuring which of {len(measure.weights)} weights may be float16")
        portion = share * (_SHARE_OF_WEIGHTS if arithmetic else _SHARE_WITHOUT_NODES)
        tables = choose_tables(measure, budget, portion)
        stored = {measure.weights[k] for k in tables.quantized}
        progress(f"measuring which of {len(nodes)} nodes may round to float16")
        measure.stored = tables.quantized
        free = [k for k, n in enumerate(nodes) if arithmetic and n not in guarded]
        found = max_quantizable(free, measure, budget=budget, allowed=share)
        spent += tables.measured + found.measured
        kept = explain(nodes, guarded, found.kept)
        if not arithmetic:
            kept = [Kept(key_of(node), "weights alone are halved") for node in nodes]
        kept += merge_islands(boundary, nodes, kept)
        casts = boundary.casts({one.node for one in kept})
        trial = model.clone()
        plain = {measure.weights[k] for k in measure.model.plain}
        _convert(trial, manifest, {one.node for one in kept}, stored, plain, outputs)
        progress("comparing the float16 model with the float32 one")
        parity = measure.of_model(trial, limits or Limits())
        if parity.holds:
            weights = [
                Kept(measure.weights[k], group.field, group.excess)
                for group in tables.kept
                for k in group.units
            ]
            result = (trial, kept, weights, casts, parity)
            break
    if result is None:
        raise RewriteFailed(
            f"its float16 kernels differ by more than rounding: {parity.describe()}",
            where="model",
            hint="Raise the tolerances in the manifest, or leave the model in float32.",
        )
    trial, kept, weights, casts, parity = result
    return trial, Float16Result(
        None,
        len(nodes) - len(kept),
        tuple(kept),
        casts,
        parity,
        before,
        weight_bytes(trial),
        frame,
        frame // 2 if outputs else frame,
        spent,
        tuple(weights),
    )


def _refuse_half_words(model: ir.Model, manifest: GeneratorManifest) -> None:
    """Refuse SH whose float16 rows would end within a word (rule GO015); RGB gets a channel more."""
    color = manifest.outputs.appearance
    if color is None or color.space != "sh":
        return
    shapes = (v.shape for v in model.graph.outputs if v.name == color.name)
    shape = next(shapes, None)
    channels = shape[-1] if shape else 0
    if isinstance(channels, int) and channels % 2:
        raise RewriteFailed(
            f"has {channels} channels of SH, whose float16 rows do not fill words of 4 bytes "
            "(rule GO015)",
            where=f"output {color.name}",
            hint="Keep outputs float32 (`gsgen float16 --keep-outputs`), or export anew with "
            "`--dtype float16`, which fills SH up.",
        )


def _convert(
    model: ir.Model,
    manifest: GeneratorManifest,
    keep: Collection[str],
    stored: Collection[str],
    plain: Collection[str],
    outputs: bool,
) -> None:
    ToFloat16(keep, outputs=outputs, stored=stored, plain=plain)(model)
    declared = manifest.outputs
    assert declared.gaussians is not None
    assert declared.appearance is not None
    if outputs:
        if declared.appearance.space == "rgb":
            PadColor(declared.appearance.name)(model)
        text = dumps(half_manifest(manifest), indent=None)
        model.metadata_props[MANIFEST_KEY] = text
    tidy(model)


def half_manifest(manifest: GeneratorManifest) -> GeneratorManifest:
    """Return what a manifest says once all outputs but the count are float16."""
    declared = manifest.outputs
    assert declared.gaussians is not None
    cells = declared.cells and replace(declared.cells, dtype="float16")
    rows = replace(declared.gaussians, dtype="float16")
    return replace(manifest, outputs=replace(declared, gaussians=rows, cells=cells))

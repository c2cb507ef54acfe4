"""Converts an ONNX generator to float16, except where rounding errors exceed the tolerance.

A search rounds nodes alone and in groups, at the contract's probes, and compares the outputs with
those of float32 in the contract's units: positions in standard deviations of their Gaussian,
covariances relative to their trace, opacity absolutely, appearance from 64 directions. Tables of
weights are stored in 16 bits a number, also for float32 nodes, if their rounding is small enough.
"""

__all__ = ["Float16Result", "float16_manifest", "to_float16", "write_float16"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import onnx_ir as ir

from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import MANIFEST_KEY, NEUTRAL_KEY, open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import GeneratorManifest, Tolerances
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.targets import load_target
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.float16.error_measure import ErrorProbe
from gsgen.sdk.float16.precision_policy import (
    RetainedFloat32,
    choose_tables,
    epsilon_guards,
    merge_islands,
    retained_nodes,
)
from gsgen.sdk.float16.sensitivity_search import max_quantizable
from gsgen.sdk.float16.to_float16 import Boundary, ToFloat16, can_compute_in_float16, node_key
from gsgen.sdk.parity import Parity
from gsgen.sdk.passes.framework.base import opset_of
from gsgen.sdk.passes.repairs import PadColor
from gsgen.sdk.rewriting.constant_subgraph import constant_nodes
from gsgen.sdk.rewriting.model_io import (
    has_external_weights,
    load_model,
    refuse_overwriting,
    save_model,
    weight_bytes,
)
from gsgen.sdk.rewriting.output_equivalence import probes_of
from gsgen.sdk.rewriting.rewrite import normalize_model, remove_unused

_MAX_MEASUREMENTS = 200
# Share of the tolerance for storing weights in 16 bits: if nodes are searched, too, and if not.
_WEIGHT_ERROR_SHARE, _WEIGHTS_ONLY_ERROR_SHARE = 0.5, 0.6
# Share of that error for small tables, if nodes are not searched: their bytes hardly count.
_SMALL_TABLE_SHARE = 0.1
# Share of the tolerance for the search, from one attempt to the next: the error that real kernels
# add to the measured rounding is known only at the end.
_TOLERANCE_SHARES = (1.0, 0.5, 0.25)

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Float16Result:
    """The result of a conversion to float16: counts of nodes and weights, errors, and path.

    Attributes:
        path: The file; None if it was not written.
        converted_count: Number of nodes that compute in float16.
        retained: Nodes that could, but compute in float32.
        casts: Number of Casts between float16 and float32 nodes.
        parity: The final model compared with the source, field by field.
        bytes_before: Bytes of weights in the source.
        bytes_after: Bytes of weights in the result.
        outputs_before: Bytes of outputs a frame in the source.
        outputs_after: Bytes of outputs a frame in the result.
        measured: Number of measured choices of nodes and tables.
        retained_weights: Tables that are stored in float32, with the field that 16 bits would
            change.
    """

    path: Path | None
    converted_count: int
    retained: tuple[RetainedFloat32, ...]
    casts: int
    parity: Parity
    bytes_before: int
    bytes_after: int
    outputs_before: int
    outputs_after: int
    measured: int
    retained_weights: tuple[RetainedFloat32, ...] = ()


def write_float16(
    source: Path,
    path: Path | None,
    *,
    outputs: bool = True,
    tolerances: Tolerances | None = None,
    budget: int = _MAX_MEASUREMENTS,
    limits: Limits | None = None,
    progress: Progress = lambda _: None,
) -> Float16Result:
    """Convert a model file to float16, and write the result to another file.

    Args:
        source: A Gaussian Generator with a manifest, in float32.
        path: The file of the result; if None, the result is measured but not written.
        outputs: Whether the outputs become float16, too.
        tolerances: Allowed errors; the manifest's, or the contract's defaults, if absent.
        budget: Largest number of choices of nodes to measure.
        limits: Time and memory for running the result.
        progress: Called with a message when a step begins.

    Raises:
        ModelUnreadable: ``source`` is not a readable model.
        ConfigInvalid: ``path`` would replace the weights of ``source``.
        RewriteFailed: The model has no manifest, is float16 already, has SH whose float16 rows
            do not fill words, or every choice exceeds the tolerances.
    """
    limits = limits or Limits()
    subject = inspect_model(open_model(source), load_target("core"), limits)
    if path is not None:
        refuse_overwriting(subject.file, path)
    manifest = subject.parsed.manifest if subject.parsed is not None else None
    if not isinstance(manifest, GeneratorManifest) or manifest.outputs.gaussians is None:
        raise RewriteFailed(
            "the model has no manifest of a Gaussian Generator, so errors have no units",
            where=str(source),
            hint="Derive one with `gsgen inspect MODEL --emit-manifest` and embed it with "
            "`gsgen fix`.",
        )
    model = load_model(source)
    probes = probes_of(subject, {})
    names = [tensor.name for tensor in subject.graph.outputs]
    _require_successful_run(source, names, probes, limits.for_model(subject.file.weight_bytes))
    external_weights = has_external_weights(model)
    normalize_model(model)
    converted, result = to_float16(
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
            save_model(converted, draft, external_weights=external_weights)
    return replace(result, path=path)


def _require_successful_run(
    source: Path, names: Sequence[str], probes: Sequence[Probe], limits: Limits
) -> None:
    """Raise if a model does not run within its limits; the search runs it without any."""
    with execute(source, names, probes, limits) as execution:
        if execution.fault is not None:
            message = f"ONNX Runtime cannot run the model: {execution.fault.message}"
            raise RewriteFailed(message, where=str(source), hint=execution.fault.hint)


def to_float16(
    model: ir.Model,
    manifest: GeneratorManifest,
    probes: Sequence[Probe],
    *,
    outputs: bool = True,
    tolerances: Tolerances | None = None,
    arithmetic: bool = True,
    roundings: int = 1,
    budget: int = _MAX_MEASUREMENTS,
    limits: Limits | None = None,
    progress: Progress = lambda _: None,
) -> tuple[ir.Model, Float16Result]:
    """Return a float16 copy of a model, and the nodes and weight tables that stay float32.

    Without ``arithmetic``, every node computes in float32, and only weights and outputs are stored
    in 16 bits. The rounding of stored outputs is added to the tolerances ``roundings`` times. All
    other options are those of :func:`write_float16`.
    """
    if outputs:
        _refuse_odd_float16_sizes(model, manifest)
    progress("running the model in float32")
    allowed = tolerances or manifest.tolerances or Tolerances()
    measure = ErrorProbe(
        model,
        manifest,
        probes,
        allowed,
        half_outputs=outputs,
        roundings=roundings,
        weights_only=not arithmetic,
    )
    conversion_search = _ConversionSearch(model, measure, arithmetic=arithmetic, budget=budget)
    if not conversion_search.nodes and not measure.weights:
        raise RewriteFailed(
            "the model has no node that computes in float32, and no large float32 weight",
            where="model",
        )
    if not measure.rounded.holds:
        raise RewriteFailed(
            f"float16 outputs alone are too coarse: {measure.rounded.describe()}",
            where="outputs",
            hint="Keep them float32 (`gsgen float16 --keep-outputs`), or move the scene closer to "
            "its origin.",
        )
    for share in _TOLERANCE_SHARES:
        choice = conversion_search.choose_float16(share, progress)
        converted = model.clone()
        _convert_nodes(
            converted, _with_loosened_tolerances(manifest, allowed), choice, outputs=outputs
        )
        progress("comparing the float16 model with the float32 one")
        parity = measure.model_parity(converted, limits or Limits())
        if parity.holds:
            break
    else:
        message = f"its float16 kernels differ by more than rounding: {parity.describe()}"
        hint = "Raise the tolerances in the manifest, or leave the model in float32."
        raise RewriteFailed(message, where="model", hint=hint)
    frame = measure.frame_bytes
    return converted, Float16Result(
        path=None,
        converted_count=len(conversion_search.nodes) - len(choice.retained),
        retained=choice.retained,
        casts=conversion_search.boundary.casts(choice.retained_names),
        parity=parity,
        bytes_before=weight_bytes(model),
        bytes_after=weight_bytes(converted),
        outputs_before=frame,
        outputs_after=frame // 2 if outputs else frame,
        measured=conversion_search.measured,
        retained_weights=choice.retained_weights,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Float16Choice:
    """The chosen nodes that stay float32, and the weight tables to store in 16 bits."""

    retained: tuple[RetainedFloat32, ...]  # nodes that compute in float32, with reasons
    retained_weights: tuple[RetainedFloat32, ...]  # tables that are stored in float32, with reasons
    stored: frozenset[str]  # names of the tables that are stored in 16 bits a number
    unstepped: frozenset[str]  # names of those that are stored as float16, not in even steps

    @property
    def retained_names(self) -> set[str]:
        return {entry.node for entry in self.retained}


class _ConversionSearch:
    """Searches for nodes and weight tables that can be rounded to float16 together.

    Attributes:
        nodes: The nodes that can compute in float16.
        boundary: Counts the Casts of a choice.
        measured: Number of measured choices so far.
    """

    def __init__(
        self, model: ir.Model, measure: ErrorProbe, *, arithmetic: bool, budget: int
    ) -> None:
        opset, constants = opset_of(model), set(constant_nodes(model.graph))
        self.nodes = [
            node
            for node in model.graph
            if node not in constants and can_compute_in_float16(node, opset)
        ]
        self.boundary = Boundary(model.graph, opset)
        self.measured = 0
        self._measure, self._budget, self._arithmetic = measure, budget, arithmetic
        self._guard_reasons = epsilon_guards(self.nodes, opset)

    def choose_float16(self, share: float, progress: Progress) -> _Float16Choice:
        """Choose the weights, then the nodes, that float16 can hold within the tolerance."""
        measure, nodes = self._measure, self.nodes
        # Tables come first: their size decides the size of the file and of the download.
        progress(f"measuring which of {len(measure.weights)} weights may be float16")
        weight_share = share * (
            _WEIGHT_ERROR_SHARE if self._arithmetic else _WEIGHTS_ONLY_ERROR_SHARE
        )
        small_table_share = weight_share if self._arithmetic else _SMALL_TABLE_SHARE * weight_share
        tables = choose_tables(measure, self._budget, weight_share, small_table_share)
        progress(f"measuring which of {len(nodes)} nodes may round to float16")
        measure.stored = tables.quantized
        searchable_nodes = [
            index
            for index, node in enumerate(nodes)
            if self._arithmetic and node not in self._guard_reasons
        ]
        node_search = max_quantizable(searchable_nodes, measure, budget=self._budget, allowed=share)
        self.measured += tables.measured + node_search.measured
        if self._arithmetic:
            retained = retained_nodes(nodes, self._guard_reasons, node_search.retained)
        else:
            retained = [
                RetainedFloat32(node_key(node), "only weights are stored in 16 bits")
                for node in nodes
            ]
        retained += merge_islands(self.boundary, nodes, retained)
        return _Float16Choice(
            retained=tuple(retained),
            retained_weights=tuple(
                RetainedFloat32(measure.weights[index], group.field, group.excess)
                for group in tables.retained
                for index in group.units
            ),
            stored=frozenset(measure.weights[index] for index in tables.quantized),
            unstepped=frozenset(measure.weights[index] for index in measure.model.unstepped),
        )


def _refuse_odd_float16_sizes(model: ir.Model, manifest: GeneratorManifest) -> None:
    """Raise if rows of float16 SH would not fill whole 32-bit words (rule GO015)."""
    color = manifest.outputs.appearance
    if color is None or color.space != "sh":
        return
    shapes = (v.shape for v in model.graph.outputs if v.name == color.name)
    shape = next(shapes, None)
    channels = shape[-1] if shape else 0
    if isinstance(channels, int) and channels % 2:
        raise RewriteFailed(
            f"the output has {channels} channels of SH, whose float16 rows do not fill words of 4 bytes "
            "(rule GO015)",
            where=f"output {color.name}",
            hint="Keep outputs float32 (`gsgen float16 --keep-outputs`), or export with "
            "`--dtype float16`, which pads the SH.",
        )


def _convert_nodes(
    model: ir.Model, manifest: GeneratorManifest, choice: _Float16Choice, *, outputs: bool
) -> None:
    ToFloat16(
        choice.retained_names, outputs=outputs, stored=choice.stored, unstepped=choice.unstepped
    )(model)
    declared = manifest.outputs
    assert declared.gaussians is not None
    assert declared.appearance is not None
    if outputs:
        if declared.appearance.space == "rgb":
            PadColor(declared.appearance.name)(model)
        manifest = float16_manifest(manifest)
    if outputs or manifest.test_vectors:
        model.metadata_props.pop(NEUTRAL_KEY, None)
        model.metadata_props[MANIFEST_KEY] = dumps(manifest, indent=None)
    remove_unused(model)


def _with_loosened_tolerances(
    manifest: GeneratorManifest, allowed: Tolerances
) -> GeneratorManifest:
    """Return a manifest with float16 rounding errors added to its test vectors' tolerances."""
    vectors = []
    for vector in manifest.test_vectors:
        vector_tolerances = vector.tolerances or manifest.tolerances or Tolerances()
        summed_tolerances = {
            field.name: getattr(vector_tolerances, field.name) + getattr(allowed, field.name)
            for field in fields(Tolerances)
        }
        vectors.append(
            replace(vector, tolerances=Tolerances(**summed_tolerances))
            if vector.outputs
            else vector
        )
    return replace(manifest, test_vectors=tuple(vectors))


def float16_manifest(manifest: GeneratorManifest) -> GeneratorManifest:
    """Return a copy of the manifest in which all outputs but the row count are float16."""
    declared = manifest.outputs
    assert declared.gaussians is not None
    cells = declared.cells and replace(declared.cells, dtype="float16")
    rows = replace(declared.gaussians, dtype="float16")
    return replace(manifest, outputs=replace(declared, gaussians=rows, cells=cells))

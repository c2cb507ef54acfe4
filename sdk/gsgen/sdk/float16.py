"""Convert a model to float16, and keep in float32 what would show: measured, not listed by name.

Every node is rounded on its own and in groups, at the contract's probes, and the outputs are
compared with those of float32 in the contract's units: positions in standard deviations of their
Gaussian, covariances relative to their trace, opacity absolutely, appearance from 64 directions.
"""

__all__ = ["Halved", "Kept", "half_manifest", "to_float16", "write_float16"]

import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx_ir as ir

from gsgen.contract import layout
from gsgen.contract.manifest import GeneratorManifest, Tolerances
from gsgen.contract.manifest_json import dumps
from gsgen.contract.model import MANIFEST_KEY, open_model
from gsgen.contract.probes import Probe, default_probes
from gsgen.contract.sandbox import Limits, execute
from gsgen.contract.subject import read_subject
from gsgen.contract.targets import load_target
from gsgen.sdk.constant_part import constant_nodes
from gsgen.sdk.equivalence import probes_of
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.half_model import GUARD_ELEMENTS, LARGEST, HalfModel
from gsgen.sdk.half_table import LEAST_ELEMENTS
from gsgen.sdk.parity import FieldParity, Made, Parity, Reference, compare
from gsgen.sdk.passes.base import is_op, opset_of
from gsgen.sdk.passes.building import known_array
from gsgen.sdk.passes.repairs import PadColor
from gsgen.sdk.passes.to_float16 import (
    FLOAT,
    Boundary,
    ToFloat16,
    halves,
    key_of,
    places_of,
)
from gsgen.sdk.placement import draft_of
from gsgen.sdk.rewrite import prepare, tidy
from gsgen.sdk.saving import (
    has_external_weights,
    refuse_overwriting,
    save_model,
    weight_bytes,
)
from gsgen.sdk.unit_search import Search, Sensitivity, largest_harmless

_BUDGET = 200
_LEAST_ROOM = 1e-3
# How much of what is allowed may be used up by storing weights, whatever is computed with them.
_SHARE_OF_WEIGHTS, _SHARE_WITHOUT_NODES = 0.5, 0.6
# A number that has no divisor with that of the probes searched at, so that times differ.
_UNSEEN = 12
# How much of the tolerance the search may use, from one attempt to the next: what the real kernels
# add to the measured rounding is seen only at the end.
_SHARES = (1.0, 0.5, 0.25)
_NORMAL = 2.0**-14
_BEHIND_GUARDS = (
    *("Sqrt", "Reciprocal", "Pow", "Cast", "Expand", "Reshape", "Squeeze", "Unsqueeze"),
    *("Transpose", "Identity", "Slice", "Gather", "Where", "Clip", "Max", "Min"),
)

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Kept:
    """A node that stays float32.

    Attributes:
        node: Its name, which is that of its first result.
        why: The field that would show it, a guard, a decision, or a neighbour that saves Casts.
        excess: How much of what is allowed, beyond the rounding of outputs, its group alone would
            use up; 0 where that is not the reason.
    """

    node: str
    why: str
    excess: float = 0.0


@dataclass(frozen=True, slots=True)
class Halved:
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
        kept_weights: Which tables are stored in float32, and the field that would show it.
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
) -> Halved:
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
    subject = read_subject(open_model(source), load_target("core"), limits)
    if path is not None:
        refuse_overwriting(subject.file, path)
    manifest = subject.parsed.manifest if subject.parsed is not None else None
    if not isinstance(manifest, GeneratorManifest) or manifest.outputs.gaussians is None:
        raise RewriteFailed(
            "has no manifest of a Gaussian Generator, so errors have no units",
            where=str(source),
            mend="Derive one with `gsgen inspect MODEL --emit-manifest` and embed it with "
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
        with draft_of(path) as draft:
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
) -> tuple[ir.Model, Halved]:
    """Return ``model`` converted, and how; see :func:`write_float16`.

    Without ``arithmetic``, weights and outputs become float16, and every node computes in float32 as
    before. ``roundings``: how often what storing outputs rounds may be added to the tolerances.

    Raises:
        RewriteFailed: No choice of nodes keeps the tolerances.
    """
    allowed = tolerances or manifest.tolerances or Tolerances()
    if outputs:
        _refuse_half_words(model, manifest)
    progress("running the model in float32")
    measure = _Measure(model, manifest, probes, allowed, outputs, roundings)
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
            mend="Keep them float32 with --keep-outputs, or move the scene closer to its origin.",
        )
    guards = _guards(nodes, opset)
    spent, result = 0, None
    for share in _SHARES:
        # Tables come first: they are what is stored, loaded and sent.
        progress(f"measuring which of {len(measure.weights)} weights may be float16")
        portion = share * (_SHARE_OF_WEIGHTS if arithmetic else _SHARE_WITHOUT_NODES)
        tables = _choose_tables(measure, budget, portion)
        stored = {measure.weights[k] for k in tables.given_up}
        progress(f"measuring which of {len(nodes)} nodes may round to float16")
        measure.stored = tables.given_up
        free = [k for k, n in enumerate(nodes) if arithmetic and n not in guards]
        found = largest_harmless(free, measure, budget=budget, allowed=share)
        spent += tables.measured + found.measured
        kept = _explain(nodes, guards, found.kept)
        if not arithmetic:
            kept = [Kept(key_of(node), "weights alone are halved") for node in nodes]
        kept += _islands(boundary, nodes, kept)
        casts = boundary.casts({one.node for one in kept})
        trial = model.clone()
        _convert(trial, manifest, {one.node for one in kept}, stored, outputs)
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
            mend="Raise the tolerances in the manifest, or leave the model in float32.",
        )
    trial, kept, weights, casts, parity = result
    return trial, Halved(
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


def _choose_tables(measure: "_Measure", budget: int, allowed: float) -> Search:
    """Find tables to store in 16 bits: large ones first, since small ones hardly matter."""
    large = [k for k, size in enumerate(measure.sizes) if size >= LEAST_ELEMENTS]
    first = largest_harmless(large, measure.of_weights, budget=budget, allowed=allowed)
    small = [k for k, size in enumerate(measure.sizes) if size < LEAST_ELEMENTS]
    second = largest_harmless(
        small,
        lambda more: measure.of_weights([*first.given_up, *more]),
        budget=budget - first.measured,
        allowed=allowed,
    )
    return Search(
        first.given_up | second.given_up,
        (*first.kept, *second.kept),
        first.measured + second.measured,
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
            mend="Keep outputs float32 with --keep-outputs, or export with SH of degree 1 or 3.",
        )


class _Measure:
    """Measures the error of rounding some nodes of a model, in the contract's units."""

    def __init__(
        self,
        model: ir.Model,
        manifest: GeneratorManifest,
        probes: Sequence[Probe],
        tolerances: Tolerances,
        outputs: bool,
        roundings: int,
    ) -> None:
        self.roundings = roundings
        declared = manifest.outputs
        assert declared.gaussians is not None
        if declared.appearance is None or declared.count is None:
            raise RewriteFailed("names no appearance or count", where="manifest.outputs")
        self.names = (
            declared.gaussians.name,
            declared.appearance.name,
            declared.count.name,
            *([declared.cells.name] if declared.cells is not None else []),
        )
        self.space, self.tolerances = declared.appearance.space, tolerances
        self.probes, self.storage = probes, np.float16 if outputs else np.float32
        self._model = HalfModel(model)
        self.weights, self.sizes = self._model.weights, self._model.sizes
        self.stored: Collection[int] = ()
        self._references = [self._reference(probe) for probe in probes]
        self._unseen = [self._reference(probe) for probe in _unseen(manifest, probes)]
        self.rounded = self.parity(frozenset())
        self._stored = {one.field: _excess(one) for one in self.rounded.fields}

    @property
    def frame_bytes(self) -> int:
        """Bytes of float32 rows that a frame gives."""
        made = self._model.run(
            self.probes[0].inputs, np.zeros(len(self._model.units), np.bool_)
        )
        return sum(made[name].nbytes for name in self.names if made[name].dtype.kind == "f")

    def _reference(self, probe: Probe) -> Reference:
        nothing = np.zeros(len(self._model.units), np.bool_)
        made = self._read(self._model.run(probe.inputs, nothing))
        if made.rows.dtype != np.float32:
            what = f"is {made.rows.dtype} already"
            raise RewriteFailed(what, where=f"output {self.names[0]}")
        cells = None if made.cells is None else layout.decode_cells(made.cells)
        rows = layout.decode(made.rows, made.color, self.space)
        return Reference(probe, rows, made.count, cells)

    def _read(self, made: Mapping[str, np.ndarray]) -> Made:
        rows, color, count, *cells = (made[name] for name in self.names)
        return Made(rows, color, int(np.ravel(count)[0]), *cells)

    def _stored_as(self, one: Made) -> Made:
        """Return the same as the outputs will hold it."""
        with np.errstate(over="ignore"):
            cells = None if one.cells is None else one.cells.astype(self.storage)
            rows, color = one.rows.astype(self.storage), one.color.astype(self.storage)
            return Made(rows, color, one.count, cells)

    def parity(self, chosen: Collection[int]) -> Parity:
        """Compare the outputs with the ``chosen`` units rounded, and stored as they will be."""
        flags = np.zeros(len(self._model.units), np.bool_)
        flags[list(chosen)] = True
        stored = np.zeros(len(self.weights), np.bool_)
        stored[list(self.stored)] = True
        runs = (self._model.run(probe.inputs, flags, stored) for probe in self.probes)
        made = [self._stored_as(self._read(one)) for one in runs]
        return self._compared(self._references, made)

    def _compared(self, references: Sequence[Reference], made: Sequence[Made]) -> Parity:
        return compare(references, made, self.tolerances, roundings=self.roundings)

    def __call__(self, chosen: Collection[int]) -> tuple[float, str]:
        """Return how much of the room that storage leaves is used up, and in which field."""
        used = {one.field: self._used(one) for one in self.parity(chosen).fields}
        worst = max(used, key=lambda field: used[field], default="")
        return used.get(worst, 0.0), worst

    def of_weights(self, stored: Collection[int]) -> tuple[float, str]:
        """Return the same of storing these tables in float16, with nothing computed in it."""
        self.stored = stored
        return self(())

    def _used(self, field: FieldParity) -> float:
        """Return the share of a field's tolerance that is used, storage in float16 left out."""
        base = self._stored.get(field.field, 0.0)
        return float((_excess(field) - base) / max(1 - base, _LEAST_ROOM))

    def of_model(self, model: ir.Model, limits: Limits) -> Parity:
        """Run a converted model in ONNX Runtime, at probes that the search did not see, too."""
        references = [*self._references, *self._unseen]
        probes = [one.probe for one in references]
        with tempfile.TemporaryDirectory(prefix="gsgen-") as folder:
            file = Path(folder) / "float16.onnx"
            save_model(model, file, beside=has_external_weights(model))
            size = sum(one.stat().st_size for one in Path(folder).iterdir())
            with execute(file, self.names, probes, limits.for_model(size)) as execution:
                if execution.fault is not None:
                    raise RewriteFailed(
                        f"ONNX Runtime cannot run the result: {execution.fault.message}",
                        where="float16",
                    )
                made = [
                    self._read(execution.samples[run.sample].outputs)
                    for run in execution.runs
                ]
                return self._compared(references, made)


def _unseen(manifest: GeneratorManifest, probes: Sequence[Probe]) -> tuple[Probe, ...]:
    """Return probes of other cameras, times and poses than those that nodes were chosen at."""
    inputs = probes[0].inputs
    shapes = {name: array.shape for name, array in inputs.items()}
    dtypes = {name: array.dtype.name for name, array in inputs.items()}
    return default_probes(manifest, shapes, dtypes, seed=1, count=_UNSEEN) if inputs else ()


def _excess(field: FieldParity) -> float:
    return field.excess if field.excess <= np.inf else np.inf


def _convert(
    model: ir.Model,
    manifest: GeneratorManifest,
    keep: Collection[str],
    stored: Collection[str],
    outputs: bool,
) -> None:
    ToFloat16(keep, outputs=outputs, stored=stored)(model)
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


def _guards(nodes: Sequence[ir.Node], opset: int) -> dict[ir.Node, str]:
    """Return nodes that are kept from float16 whatever the probes show.

    An epsilon that becomes zero guards nothing, and what it guards may only be zero in a frame that
    no probe has; so all that follows it stays, up to the division. And a comparison turns a small
    error into a large one, at some time between the probes.
    """
    found: dict[ir.Node, str] = {}
    front: list[ir.Node] = []
    for node in nodes:
        if not places_of(node, opset)[1]:
            found[node] = "it decides"
        for value in node.inputs:
            array = (
                known_array(value) if value is not None and value.dtype == FLOAT else None
            )
            if array is None:
                continue
            size = np.abs(array[np.isfinite(array)])
            if (size > LARGEST).any():
                found[node] = "a constant beyond 65,504"
            elif array.size <= GUARD_ELEMENTS and ((size > 0) & (size < _NORMAL)).any():
                found[node] = "a guard that float16 makes zero"
                front.append(node)
    while front:
        for reader in (use.node for v in front.pop().outputs for use in v.uses()):
            ends = is_op(reader, "Div", "Mul")
            if reader in found or not (ends or is_op(reader, *_BEHIND_GUARDS)):
                continue
            found[reader] = "what a guard guards"
            if not ends:
                front.append(reader)
    return found


def _explain(
    nodes: Sequence[ir.Node], guards: Mapping[ir.Node, str], costly: Sequence[Sensitivity]
) -> list[Kept]:
    able = set(nodes)
    kept = [Kept(key_of(node), why) for node, why in guards.items() if node in able]
    for group in costly:
        kept += [Kept(key_of(nodes[k]), group.field, group.excess) for k in group.units]
    return kept


def _islands(
    boundary: Boundary, nodes: Sequence[ir.Node], kept: Sequence[Kept]
) -> list[Kept]:
    """Return nodes among the kept ones that need fewer Casts if they are kept, too."""
    keep = {one.node for one in kept}
    added: list[Kept] = []
    while True:
        fresh = [
            node
            for node in nodes
            if key_of(node) not in keep
            and _borders(node, keep)
            and boundary.saved(node, keep) > 0
        ]
        if not fresh:
            return added
        keep.add(key_of(fresh[0]))
        added.append(Kept(key_of(fresh[0]), "saves Casts"))


def _borders(node: ir.Node, keep: Collection[str]) -> bool:
    near = [value.producer() for value in node.inputs if value is not None]
    near += [use.node for value in node.outputs for use in value.uses()]
    return any(one is not None and key_of(one) in keep for one in near)

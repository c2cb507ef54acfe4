"""Rewrites a graph for a runtime: applies rewrites until nothing changes, compares outputs.

Step 1 runs the passes that keep every bit, step 2 all passes. After each step, the model is run at
the contract's probes and compared with the model before it. If it differs by more than the passes
declare, it is not written.
"""

__all__ = [
    "Change", "GraphStats", "RewriteResult", "graph_stats", "normalize_model", "rewrite_file", "rewrite_graph",
]  # fmt: skip

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import or_
from pathlib import Path

import onnx
import onnx_ir as ir
from onnx_ir.passes.common import (
    InlinePass,
    LiftConstantsToInitializersPass,
    NameFixPass,
    RemoveUnusedFunctionsPass,
    RemoveUnusedNodesPass,
)

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.graph import read_graph
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.model.provider_placement import Placement, placements
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.contract.spec.operator_tables import FAILED_OUTCOMES
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.passes.framework.base import BIT_EXACT, ErrorBudget, Rewrite, RewriteTarget, opset_of
from gsgen.sdk.passes.framework.cautious_rewrite import Refusal, SkippableRewrite
from gsgen.sdk.passes.framework.shape_inference import infer_shapes
from gsgen.sdk.passes.registry import find_rewrites
from gsgen.sdk.rewriting.model_io import (
    has_external_weights,
    load_model,
    refuse_overwriting,
    save_model,
)
from gsgen.sdk.rewriting.output_equivalence import Difference, compare_files, probes_of
from gsgen.sdk.rewriting.rule_regression import refuse_new_violations

# Passes enable each other a few times at most; more rounds mean that two undo each other.
_MAX_REWRITE_ROUNDS = 20

# A graph that breaks these rules has no defined result that a rewrite could preserve.
_GRAPH_RULES = ("GG015", "GG019")

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Change:
    """The nodes that one graph rewrite changed."""

    rewrite: str  # name of the pass
    exactness: ErrorBudget  # the allowed change of outputs
    nodes: tuple[str, ...]  # names of the rewritten nodes, in order, over all rounds


@dataclass(frozen=True, slots=True)
class GraphStats:
    """Counts of a graph's nodes, and the nodes that the target cannot record (graph capture)."""

    nodes: int  # number of nodes of the main graph
    opset: int  # the operator set
    # nodes that a release of the target is known not to capture, with reasons
    uncaptured: tuple[str, ...]
    unmeasured: tuple[str, ...] = ()  # nodes for which no measurement exists


@dataclass(frozen=True, slots=True, kw_only=True)
class RewriteResult:
    """The result of rewriting a graph: changes, node counts, and output differences."""

    path: Path | None  # the file; None if it was not written
    changes: tuple[Change, ...]  # the changes of each pass; empty if no pass applied
    before: GraphStats  # counts of the source
    after: GraphStats  # counts of the result
    probes: int  # number of probes at which the two were compared
    differences: tuple[Difference, ...]  # the largest difference of each output whose bits changed
    # nodes that passes left unchanged, because they could not prove the change correct
    refusals: tuple[Refusal, ...] = ()
    # outputs without a finite number at any probe, so that no change can be seen
    uncompared: tuple[str, ...] = ()


def rewrite_graph(
    model: ir.Model,
    rewrite_target: RewriteTarget,
    only: Sequence[str] = (),
    skip: Sequence[str] = (),
) -> list[Change]:
    """Apply the rewrites of a target runtime to a model, in place, until nothing changes."""
    rewrites = find_rewrites(rewrite_target, only, skip)
    normalize_model(model)
    changes = _merge_changes(
        [
            *_apply_until_stable(model, _bit_exact_rewrites(rewrites)),
            *_apply_until_stable(model, rewrites),
        ]
    )
    if changes:
        remove_unused(model)
    return changes


def rewrite_file(
    source: Path,
    path: Path | None,
    target: Target,
    *,
    only: Sequence[str] = (),
    skip: Sequence[str] = (),
    opset: int | None = None,
    sizes: Mapping[str, int] | None = None,
    limits: Limits | None = None,
    progress: Progress = lambda _: None,
) -> RewriteResult:
    """Rewrite a model file for a target runtime, and write the result to another file.

    A model without a manifest gets probes from the shapes and dtypes of its inputs; a symbolic size
    counts as 3 unless ``sizes`` has it.

    ``only`` and ``skip`` are names of passes; the target's kernels choose ``opset`` by default.
    Without ``path``, the result is compared but not written. A result that is ill-formed, breaks a
    rule that ``source`` keeps, or computes something else is refused.
    """
    limits, sizes = limits or Limits(), sizes or {}
    progress("reading the model")
    subject = inspect_model(open_model(source), target, limits)
    settings = Settings(level=Level.STATIC, target=target)
    report = validate(source, settings)
    _refuse_invalid_model(report)
    if path is not None:
        refuse_overwriting(subject.file, path)
    manifest = subject.parsed.manifest if subject.parsed is not None else None
    rewrite_target = RewriteTarget.of(target, manifest, opset, sizes)
    rewrites = find_rewrites(rewrite_target, only, skip)
    model = _load(source, opset)
    with temporary_folder() as folder:
        run = _ComparedRun(
            model=model,
            folder=folder,
            latest=source,
            outputs=[tensor.name for tensor in subject.graph.outputs],
            probes=probes_of(subject, sizes),
            limits=limits,
            external_weights=has_external_weights(model),
            progress=progress,
        )
        normalize_model(model)
        # Step 1: the passes that keep every bit. Step 2: all passes.
        run.step("exact", _bit_exact_rewrites(rewrites))
        run.step("all", rewrites)
        progress("checking the rules on the result")
        if run.changes and manifest is not None:
            refuse_new_violations(report, validate(run.latest, settings), "rewritten")
        before, after = graph_stats(source, rewrite_target), graph_stats(run.latest, rewrite_target)
    if path is not None:
        with atomic_write(path) as draft:
            if run.changes:
                run.save(draft)
            else:
                _copy_unchanged(source, path, draft, run)
    return RewriteResult(
        path=path,
        changes=tuple(_merge_changes(run.changes)),
        before=before,
        after=after,
        probes=len(run.probes),
        differences=tuple(run.differences),
        refusals=tuple(_refused_rewrites(rewrites)),
        uncompared=run.uncompared,
    )


@dataclass(slots=True, kw_only=True)
class _ComparedRun:
    """Applies graph rewrites in steps, and compares the model's outputs before and after each."""

    model: ir.Model  # the graph; passes change it
    folder: Path  # folder of the drafts
    latest: Path  # the file of the latest step
    outputs: Sequence[str]  # names of the outputs to compare
    probes: Sequence[Probe]  # inputs to compare at
    limits: Limits  # time and memory for running a draft
    external_weights: bool  # whether drafts store weights in a second file
    progress: Progress  # called with a message when a step begins
    changes: list[Change] = field(default_factory=list)  # the changes of all steps
    differences: list[Difference] = field(default_factory=list)  # the differences of all steps
    uncompared: tuple[str, ...] = ()  # outputs without a finite number in the latest step

    def step(self, name: str, rewrites: Sequence[Rewrite]) -> None:
        """Apply rewrites until nothing changes, and compare the outputs if the graph changed."""
        self.progress(f"rewriting: {len(rewrites)} passes")
        changes = _apply_until_stable(self.model, rewrites)
        if not changes:
            return
        remove_unused(self.model)
        draft = self.folder / f"{name}.onnx"
        self.save(draft)
        _check_well_formed(draft, changes)
        self.progress(f"comparing outputs at {len(self.probes)} probes")
        allowed = reduce(or_, (change.exactness for change in changes), BIT_EXACT)
        comparison = compare_files(
            self.latest, draft, self.outputs, self.probes, self.limits, allowed, _names(changes)
        )
        self.differences += comparison.differences
        self.uncompared = comparison.uncompared
        self.changes += changes
        self.latest = draft

    def save(self, path: Path) -> None:
        """Write the rewritten graph to a model file."""
        save_model(self.model, path, external_weights=self.external_weights)


def _copy_unchanged(source: Path, path: Path, draft: Path, run: _ComparedRun) -> None:
    """Write a model that no pass changed: the bytes of its file.

    A copy in another folder would miss external weights; it gets a file of weights of its own.
    """
    if not run.external_weights or path.parent.resolve() == source.parent.resolve():
        shutil.copyfile(source, draft)
        return
    save_model(load_model(source), draft, external_weights=True)
    compare_files(source, draft, run.outputs, run.probes, run.limits, BIT_EXACT, "copy")


def _refuse_invalid_model(report: Report) -> None:
    """Raise if a model's external weights are unsafe to read, or its graph is ill-formed."""
    for finding in report.findings:
        is_unsafe_finding = finding.rule.startswith("GS") or finding.rule in _GRAPH_RULES
        if is_unsafe_finding and finding.severity >= Severity.ERROR:
            message = f"{finding.rule}: {finding.where}: {finding.message}"
            raise RewriteFailed(message, where=report.path, hint=finding.hint)


def _refuse_higher_opset(model: ir.Model, opset: int | None) -> None:
    current_opset = opset_of(model)
    if opset is not None and opset > current_opset:
        message = f"{opset} is above the model's operator set {current_opset}"
        hint = "Rewrites only lower it; export the model again with a higher one."
        raise ConfigInvalid(message, where="--opset", hint=hint)


def normalize_model(model: ir.Model) -> None:
    """Inline functions, turn constants into weights, name all nodes and infer a model's shapes.

    The outputs stay the same.
    """
    InlinePass()(model)
    RemoveUnusedFunctionsPass()(model)  # type: ignore[no-untyped-call]  # of onnx-ir
    LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0)(model)
    for node in model.graph.all_nodes():
        if not node.name and node.outputs:
            node.name = node.outputs[0].name  # reports name the changed nodes
    NameFixPass()(model)
    infer_shapes(model)


def remove_unused(model: ir.Model) -> None:
    """Remove nodes and weights of a graph that no node or output reads."""
    RemoveUnusedNodesPass()(model)
    NameFixPass()(model)


def _refused_rewrites(rewrites: Sequence[Rewrite]) -> list[Refusal]:
    """Return the nodes that rewrites left unchanged in their last run, with reasons."""
    return [
        r for rewrite in rewrites if isinstance(rewrite, SkippableRewrite) for r in rewrite.refusals
    ]


def _bit_exact_rewrites(rewrites: Sequence[Rewrite]) -> list[Rewrite]:
    return [rewrite for rewrite in rewrites if rewrite.exactness.bits]


def _apply_until_stable(model: ir.Model, rewrites: Sequence[Rewrite]) -> list[Change]:
    """Apply graph rewrites in rounds until a round changes nothing; return all changes."""
    changes: list[Change] = []
    for _ in range(_MAX_REWRITE_ROUNDS):
        changed = False
        for rewrite in rewrites:
            if not rewrite(model).modified:
                continue
            changed = True
            changes.append(Change(rewrite.name, rewrite.exactness, tuple(rewrite.changed)))
            RemoveUnusedNodesPass()(model)
            infer_shapes(model)
        if not changed:
            return _merge_changes(changes)
    unstable_names = ", ".join(sorted({change.rewrite for change in changes}))
    message = f"still changes after {_MAX_REWRITE_ROUNDS} rounds of {unstable_names}"
    hint = "Leave one of them out with --skip, and please report it."
    raise RewriteFailed(message, where="rewrite", hint=hint)


def _merge_changes(changes: Sequence[Change]) -> list[Change]:
    """Merge the changes that the same rewrite made in several rounds."""
    changes_by_rewrite: dict[str, Change] = {}
    for change in changes:
        known = changes_by_rewrite.get(change.rewrite)
        nodes = (*known.nodes, *change.nodes) if known else change.nodes
        changes_by_rewrite[change.rewrite] = Change(change.rewrite, change.exactness, nodes)
    return list(changes_by_rewrite.values())


def _names(changes: Sequence[Change]) -> str:
    return ", ".join(change.rewrite for change in changes)


def _load(source: Path, opset: int | None) -> ir.Model:
    model = load_model(source)
    _refuse_higher_opset(model, opset)
    return model


def _check_well_formed(file: Path, changes: Sequence[Change]) -> None:
    """Raise if ONNX's own checker rejects a model file or its shapes."""
    try:
        onnx.checker.check_model(file, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        message = f"the result is not well formed: {str(error).strip().splitlines()[0]}"
        hint = "Leave a pass out with --skip, and please report it."
        raise RewriteFailed(message, where=_names(changes), hint=hint) from error


def graph_stats(file: Path, rewrite_target: RewriteTarget) -> GraphStats:
    """Count a model's nodes, and predict which of them the target runtime cannot capture."""
    loaded_model = open_model(file)
    graph = read_graph(loaded_model)
    node_placements = placements(graph, loaded_model.proto, rewrite_target.tables)
    opsets = {entry.domain: entry.version for entry in loaded_model.proto.opset_import}
    return GraphStats(
        len(graph.nodes),
        next((opsets[domain] for domain in MAIN_DOMAIN if domain in opsets), 0),
        tuple(
            _capture_text(placement)
            for placement in node_placements
            if placement.cause not in ("", "unknown")
        ),
        tuple(
            _capture_text(placement)
            for placement in node_placements
            if placement.cause == "unknown"
        ),
    )


def _capture_text(placement: Placement) -> str:
    """Return a node's name and operator, and why graph capture does not support it."""
    name = placement.node.name or placement.node.output[0]
    reasons = sorted(
        {FAILED_OUTCOMES.get(outcome, outcome) for outcome in placement.outcomes.values()} - {""}
    )
    reason = ", ".join(reasons) or placement.cause
    return f"{name} ({placement.node.op_type} {placement.dtype}): {reason}"

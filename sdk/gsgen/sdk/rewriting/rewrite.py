"""Rewrite a graph for a consumer: small passes, run until nothing changes, and proven by running.

First run the passes that keep every bit, then all of them. After each of the two the model is run
at the contract's probes and compared with what it was; where it differs by more than the passes
declare, nothing is written.
"""

__all__ = [
    "Change",
    "GraphStats",
    "Rewritten",
    "census",
    "prepare",
    "rewrite_file",
    "rewrite_graph",
]

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
    ShapeInferencePass,
)

from gsgen.contract.errors import ConfigInvalid, ModelUnreadable
from gsgen.contract.model.graph import read_graph
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.model.provider_placement import Placement, placements
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.operator_tables import FAILURES
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.passes.framework.base import (
    BITS,
    MAIN_DOMAIN,
    ErrorBudget,
    Rewrite,
    RewriteTarget,
    opset_of,
)
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite, Refusal
from gsgen.sdk.passes.registry import find_rewrites
from gsgen.sdk.rewriting.atomic_model_files import atomic_write
from gsgen.sdk.rewriting.model_io import (
    has_external_weights,
    refuse_overwriting,
    save_model,
)
from gsgen.sdk.rewriting.output_equivalence import Difference, compare_files, probes_of
from gsgen.sdk.rewriting.rule_regression import refuse_worse

# Passes feed each other a few times at most; two that undo each other are a mistake of ours.
_MOST_ROUNDS = 20

# A graph that these do not hold of has no meaning that a rewrite could keep.
_GRAPH_RULES = ("GG015", "GG019")

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Change:
    """What one pass did.

    Attributes:
        rewrite: Name of the pass.
        exactness: How far it may change outputs.
        nodes: What was rewritten, in order, over all rounds.
    """

    rewrite: str
    exactness: ErrorBudget
    nodes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class GraphStats:
    """A graph in numbers.

    Attributes:
        nodes: Nodes of the main graph.
        opset: The operator set.
        uncaptured: Nodes of the frame that a release of the target is known not to capture, each
            with what becomes of it.
        unmeasured: Nodes of which nobody knows.
    """

    nodes: int
    opset: int
    uncaptured: tuple[str, ...]
    unmeasured: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Rewritten:
    """A finished rewrite.

    Attributes:
        path: The file; None where none was written.
        changes: What each pass did; empty where there was nothing to do.
        before: The graph as it came.
        after: The graph as it was written.
        probes: At how many sets of inputs the two were compared.
        differences: The largest difference of each output; absent where bits are equal.
        refusals: What passes left as it was, because they could not prove that they may change it.
        unjudged: Outputs that have no finite number at any probe, so that nothing was compared.
    """

    path: Path | None
    changes: tuple[Change, ...]
    before: GraphStats
    after: GraphStats
    probes: int
    differences: tuple[Difference, ...]
    refusals: tuple[Refusal, ...] = ()
    unjudged: tuple[str, ...] = ()


def rewrite_graph(
    model: ir.Model, goal: RewriteTarget, only: Sequence[str] = (), skip: Sequence[str] = ()
) -> list[Change]:
    """Run the passes that ``goal`` wants on ``model``, in place, until nothing changes.

    Raises:
        UnknownName: ``only`` or ``skip`` names no pass.
    """
    chosen = find_rewrites(goal, only, skip)
    prepare(model)
    exact = [one for one in chosen if one.exactness.bits]
    changes = _merged([*_settle(model, exact), *_settle(model, chosen)])
    if changes:
        tidy(model)
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
) -> Rewritten:
    """Write ``source``, rewritten for ``target``, to ``path``.

    Any ONNX model will do. Without a manifest its probes are made from the shapes and dtypes of its
    inputs; a symbolic size counts as 3 unless ``sizes`` knows it.

    Args:
        source: The model.
        path: Where the result goes; None computes and compares it, and writes nothing.
        target: The consumer.
        only: Passes to run; all that the target wants where empty.
        skip: Passes not to run.
        opset: Operator set of the result; the kernels decide where absent.
        sizes: Symbolic dimension → size.
        limits: What running the model may use.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        ModelUnreadable: ``source`` is no model.
        UnknownName: A name is no pass.
        ConfigInvalid: ``opset`` is above that of the model, or ``path`` would replace its weights.
        RewriteFailed: The model is unsafe or ill-formed, or the result is no valid model, breaks a rule that was kept, or computes
            something else.
    """
    limits, sizes = limits or Limits(), sizes or {}
    progress("reading the model")
    subject = inspect_model(open_model(source), target, limits)
    settings = Settings(level=Level.STATIC, target=target)
    judged = validate(source, settings)
    _refuse_broken(judged)
    if path is not None:
        refuse_overwriting(subject.file, path)
    manifest = subject.parsed.manifest if subject.parsed is not None else None
    goal = RewriteTarget.of(target, manifest, opset, sizes)
    chosen = find_rewrites(goal, only, skip)
    model = _load(source)
    _refuse_higher(model, opset)
    beside = has_external_weights(model)
    probes = probes_of(subject, sizes)
    prepare(model)
    changes: list[Change] = []
    differences: list[Difference] = []
    unjudged: tuple[str, ...] = ()
    with tempfile.TemporaryDirectory(prefix="gsgen-") as folder:
        known = source
        for name, passes in (("exact", _exact(chosen)), ("all", chosen)):
            progress(f"rewriting: {len(passes)} passes")
            fresh = _settle(model, passes)
            if not fresh:
                continue
            tidy(model)
            draft = Path(folder) / f"{name}.onnx"
            save_model(model, draft, beside=beside)
            _check_form(draft, fresh)
            progress(f"comparing outputs at {len(probes)} probes")
            allowed = reduce(or_, (one.exactness for one in fresh), BITS)
            outputs = [tensor.name for tensor in subject.graph.outputs]
            compared = compare_files(
                known, draft, outputs, probes, limits, allowed, _names(fresh)
            )
            differences += compared.differences
            unjudged = compared.unjudged
            changes += fresh
            known = draft
        progress("judging the result by the rules")
        if changes and manifest is not None:
            refuse_worse(judged, validate(known, settings), "rewritten")
        before, after = census(source, goal), census(known, goal)
    if path is not None:
        with atomic_write(path) as draft:
            save_model(model, draft, beside=beside)
    return Rewritten(
        path,
        tuple(_merged(changes)),
        before,
        after,
        len(probes),
        tuple(differences),
        tuple(_refusals(chosen)),
        unjudged,
    )


def _refuse_broken(report: Report) -> None:
    """Refuse a model whose weights are not safe to read, or whose graph is none."""
    for finding in report.findings:
        unsafe = finding.rule.startswith("GS") or finding.rule in _GRAPH_RULES
        if unsafe and finding.severity >= Severity.ERROR:
            raise RewriteFailed(
                f"{finding.rule}: {finding.where}: {finding.message}",
                where=report.path,
                hint=finding.hint,
            )


def _refuse_higher(model: ir.Model, opset: int | None) -> None:
    now = opset_of(model)
    if opset is not None and opset > now:
        raise ConfigInvalid(
            f"{opset} is above the model's operator set {now}",
            where="--opset",
            hint="Rewrites only lower it; export the model again with a higher one.",
        )


def prepare(model: ir.Model) -> None:
    """Bring ``model`` into the form that passes expect, without changing what it computes.

    Functions are written out, constants are weights, every node and value has a name of its own,
    and shapes are inferred.
    """
    InlinePass()(model)
    RemoveUnusedFunctionsPass()(model)  # type: ignore[no-untyped-call]  # of onnx-ir
    LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0)(model)
    for node in model.graph.all_nodes():
        if not node.name and node.outputs:
            node.name = node.outputs[0].name  # reports name what was changed
    NameFixPass()(model)
    _infer(model)


def tidy(model: ir.Model) -> None:
    """Drop what nothing reads any more."""
    RemoveUnusedNodesPass()(model)
    NameFixPass()(model)


def _infer(model: ir.Model) -> None:
    # Without data propagation: for tables of a million rows it takes minutes, and what it would
    # find out, the pass fold-shapes does.
    ShapeInferencePass(check_type=False, strict_mode=False, data_prop=False)(model)


def _refusals(chosen: Sequence[Rewrite]) -> list[Refusal]:
    """Return what passes left alone when they last ran."""
    return [r for one in chosen if isinstance(one, CautiousRewrite) for r in one.refusals]


def _exact(chosen: Sequence[Rewrite]) -> list[Rewrite]:
    return [one for one in chosen if one.exactness.bits]


def _settle(model: ir.Model, chosen: Sequence[Rewrite]) -> list[Change]:
    """Run passes in rounds until one changes nothing; return what each did, in order."""
    changes: list[Change] = []
    for _ in range(_MOST_ROUNDS):
        changed = False
        for one in chosen:
            if not one(model).modified:
                continue
            changed = True
            changes.append(Change(one.name, one.exactness, tuple(one.changed)))
            RemoveUnusedNodesPass()(model)
            _infer(model)
        if not changed:
            return _merged(changes)
    undoing = ", ".join(sorted({one.rewrite for one in changes}))
    raise RewriteFailed(
        f"does not settle after {_MOST_ROUNDS} rounds of {undoing}",
        where="rewrite",
        hint="Leave one of them out with --skip, and please report it.",
    )


def _merged(changes: Sequence[Change]) -> list[Change]:
    """Join what the same pass did in several rounds."""
    made: dict[str, Change] = {}
    for one in changes:
        known = made.get(one.rewrite)
        nodes = (*known.nodes, *one.nodes) if known else one.nodes
        made[one.rewrite] = Change(one.rewrite, one.exactness, nodes)
    return list(made.values())


def _names(changes: Sequence[Change]) -> str:
    return ", ".join(one.rewrite for one in changes)


def _load(source: Path) -> ir.Model:
    try:
        return ir.load(source)
    except Exception as error:  # onnx-ir's errors share no base class
        raise ModelUnreadable(f"is not a graph: {error}", where=str(source)) from error


def _check_form(file: Path, changes: Sequence[Change]) -> None:
    """Let ONNX's own checker judge the file, shapes included."""
    try:
        onnx.checker.check_model(file, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise RewriteFailed(
            f"the result is not well formed: {str(error).strip().splitlines()[0]}",
            where=_names(changes),
            hint="Leave a pass out with --skip, and please report it.",
        ) from error


def census(file: Path, goal: RewriteTarget) -> GraphStats:
    """Count the nodes of a file, and predict by tables which of them are not captured."""
    opened = open_model(file)
    graph = read_graph(opened)
    placed = placements(graph, opened.proto, goal.tables)
    opsets = {entry.domain: entry.version for entry in opened.proto.opset_import}
    return GraphStats(
        len(graph.nodes),
        next((opsets[domain] for domain in MAIN_DOMAIN if domain in opsets), 0),
        tuple(_told(one) for one in placed if one.cause not in ("", "unknown")),
        tuple(_told(one) for one in placed if one.cause == "unknown"),
    )


def _told(one: Placement) -> str:
    """Say which node it is, and why it is not captured."""
    name = one.node.name or one.node.output[0]
    fates = sorted(
        {FAILURES.get(outcome, outcome) for outcome in one.outcomes.values()} - {""}
    )
    why = ", ".join(fates) or one.cause
    return f"{name} ({one.node.op_type} {one.dtype}): {why}"

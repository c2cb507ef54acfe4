"""Base classes of graph rewrites: name, error budget, and the runtimes that need the rewrite.

A rewrite is a pass over onnx-ir in a file of its own. Its docstring gives the reason and a picture;
the documentation page is generated from it. Rewrites are listed in
:mod:`gsgen.sdk.passes.registry` and run by :mod:`gsgen.sdk.rewriting.rewrite`.
"""

__all__ = [
    "BIT_EXACT",
    "SAFE_TENSOR_COUNT",
    "ErrorBudget",
    "LimitRewrite",
    "NodeRewrite",
    "Rewrite",
    "RewriteTarget",
    "SubstituteNodes",
    "TableRewrite",
    "describe_item",
    "every_node",
    "is_op",
    "kernel_dtype",
    "opset_of",
]  # fmt: skip

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Self

import onnx_ir as ir
from onnx_ir import passes
from onnx_ir.passes.common import RemoveUnusedNodesPass

from gsgen.contract.spec.manifest import Manifest
from gsgen.contract.spec.onnx_facts import KERNEL_TYPE_INPUT, MAIN_DOMAIN
from gsgen.contract.spec.operator_tables import GRAPH_CAPTURE, OperatorTable, operator_table
from gsgen.contract.spec.targets import Target, known_targets
from gsgen.sdk.passes.framework.graph_builder import remembered_names

# WebGPU guarantees eight storage buffers a stage, and the joined tensor needs one of them.
SAFE_TENSOR_COUNT = 7


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """The largest output difference that a rewrite may cause; by default none, bit for bit."""

    relative: float = 0.0  # allowed error, relative to the largest number in the output's tensor
    absolute: float = 0.0  # allowed error in addition
    repairs_nonfinite: bool = False  # a value that was NaN or infinite may become any number
    pads: bool = False  # rows of zeros may follow the rows of an output

    @property
    def bits(self) -> bool:
        """Whether the rewrite must keep all outputs bit for bit."""
        return self == BIT_EXACT

    def describe(self) -> str:
        """Return the error budget as text, such as ``bit for bit``."""
        if not (self.relative or self.absolute):
            return "every finite value keeps its bits" if self.repairs_nonfinite else "bit for bit"
        parts = [f"{self.relative:g} of the largest value"] if self.relative else []
        parts += [f"{self.absolute:g}"] if self.absolute else []
        suffix = ", with zeros behind" if self.pads else ""
        return "within " + " and ".join(parts) + suffix

    def __or__(self, other: "ErrorBudget") -> "ErrorBudget":
        return ErrorBudget(
            self.relative + other.relative,
            self.absolute + other.absolute,
            self.repairs_nonfinite or other.repairs_nonfinite,
            self.pads or other.pads,
        )


BIT_EXACT = ErrorBudget()


@dataclass(frozen=True, slots=True, kw_only=True)
class RewriteTarget:
    """The runtime that a model is rewritten for, and its known limits."""

    target: Target  # the consumer
    # Operators that its releases have kernels for. For a target that names no releases, all known
    # tables.
    tables: tuple[OperatorTable, ...] = ()
    # its limits, such as ``concat_inputs``; without named releases, the lowest known
    limits: Mapping[str, int] = field(default_factory=dict)
    manifest: Manifest | None = None  # the model's manifest, if it has one
    opset: int | None = None  # requested operator set; None if the kernels decide
    sizes: Mapping[str, int] = field(default_factory=dict)  # symbolic dimension → its fixed size

    @classmethod
    def of(
        cls,
        target: Target,
        manifest: Manifest | None = None,
        opset: int | None = None,
        sizes: Mapping[str, int] | None = None,
    ) -> "RewriteTarget":
        """Return the limits and kernel tables of a runtime that a model is rewritten for."""
        consumers = [target] if target.operators else [*known_targets().values(), target]
        names = sorted({name for consumer in consumers for name in consumer.operators})
        limits: dict[str, int] = {}
        for consumer in consumers:
            for name, number in consumer.limits.items():
                limits[name] = min(number, limits.get(name, number))
        return cls(
            target=target,
            tables=tuple(operator_table(name) for name in names),
            limits=limits,
            manifest=manifest,
            opset=opset,
            sizes=sizes or {},
        )

    def lacks_kernel(self, node: ir.Node, opset: int, variant: str = "") -> bool:
        """Return whether a release of the target runtime is known not to capture a node."""
        dtype = kernel_dtype(node)
        outcomes = (t.outcome(node.op_type, variant, dtype, opset) for t in self.tables)
        return any(outcome not in ("", GRAPH_CAPTURE) for outcome in outcomes)


class Rewrite(passes.InPlacePass):
    """A graph rewrite that users can select on the command line.

    The docstring's first line says what it does, its body why, with a picture. Class attributes:

    * ``name``: the name that ``--pass`` and ``--skip`` take, such as ``chunk-concat``;
    * ``exactness``: the allowed difference of outputs;
    * ``wanted_by``: the targets that need it, as text; :meth:`for_target` decides.
    """

    name: ClassVar[str]
    exactness: ClassVar[ErrorBudget] = BIT_EXACT
    wanted_by: ClassVar[str] = "every target"

    def __init__(self) -> None:
        super().__init__()
        self.changed: list[str] = []
        self.opset = 0

    @classmethod
    def for_target(cls, target: RewriteTarget) -> Self | None:
        """Return the rewrite, set up for a target runtime; None if the target does not need it."""
        return cls()

    @classmethod
    def summary(cls) -> str:
        """Return the first line of the rewrite's docstring, without the full stop."""
        return (cls.__doc__ or "").strip().split("\n", 1)[0].rstrip(".")

    def call(self, model: ir.Model) -> passes.PassResult:
        """Rewrite a model in place, and record the changed nodes in :attr:`changed`."""
        self.changed, self.opset = [], opset_of(model)
        size = len(model.graph), len(model.graph.initializers)
        with remembered_names(model.graph):
            self.rewrite(model)
        if not self.changed and size != (len(model.graph), len(model.graph.initializers)):
            # It gave up after it had added nodes or weights: nothing reads them, but the next round
            # would find them, and rewriting would not end.
            RemoveUnusedNodesPass()(model)
        return passes.PassResult(model, modified=bool(self.changed))

    @abstractmethod
    def rewrite(self, model: ir.Model) -> None:
        """Rewrite a model, subgraphs included, and record every changed node."""

    def note(self, item: ir.Node | ir.Value) -> None:
        """Record that a node, an output or a weight of the graph was rewritten."""
        self.changed.append(describe_item(item))


class NodeRewrite(Rewrite):
    """A graph rewrite that replaces single nodes.

    All matches are collected first, so replacing a node must not remove another match.
    """

    def rewrite(self, model: ir.Model) -> None:
        """Replace every node that the rewrite selects, also in subgraphs."""
        for node in [node for node in every_node(model) if self.matches(node)]:
            self.note(node)
            self.replace(node)

    @abstractmethod
    def matches(self, node: ir.Node) -> bool:
        """Return whether the rewrite replaces a given node of the graph."""

    @abstractmethod
    def replace(self, node: ir.Node) -> None:
        """Replace a node of the graph by equivalent nodes."""


class TableRewrite(Rewrite):
    """A graph rewrite that depends on which operators the target runtime supports.

    Without a target, it rewrites every node that it can.
    """

    def __init__(self, target: RewriteTarget | None = None) -> None:
        super().__init__()
        self.target = target

    @classmethod
    def for_target(cls, target: RewriteTarget) -> Self | None:
        """Return the rewrite for a runtime; None without a list of operators that it supports."""
        return cls(target) if target.tables else None


class LimitRewrite(Rewrite):
    """A graph rewrite of operators with more tensors than the target GPU can bind.

    Attributes:
        limited_by: Name of the target's limit.
        limit: Maximum number of tensors that one operator may join or return.
    """

    limited_by: ClassVar[str]

    def __init__(self, limit: int = SAFE_TENSOR_COUNT) -> None:
        super().__init__()
        if limit < 2:
            raise ValueError(
                f"one operator may join at most {limit} tensors, expected a limit of 2 or more"
            )
        self.limit = limit

    @classmethod
    def for_target(cls, target: RewriteTarget) -> Self | None:
        """Return the rewrite for the target GPU's maximum tensor count; None if not limited."""
        limit = target.limits.get(cls.limited_by)
        return None if limit is None else cls(limit)


class SubstituteNodes(TableRewrite, NodeRewrite):
    """A graph rewrite of operators that the target runtime's graph capture does not support.

    Without a target, it replaces every operator of ``kinds``.
    """

    kinds: ClassVar[frozenset[str]]
    wanted_by: ClassVar[str] = "targets whose tables lack the operator"

    def matches(self, node: ir.Node) -> bool:
        """Return whether the target runtime cannot capture a node that this rewrite can replace."""
        if not is_op(node, *self.kinds):
            return False
        if self.target is not None and not self.target.lacks_kernel(
            node, self.opset, self.variant(node)
        ):
            return False
        return self.can_replace(node)

    def can_replace(self, node: ir.Node) -> bool:
        """Return whether the shapes, dtypes and constants that a replacement needs are known."""
        return True

    def variant(self, node: ir.Node) -> str:
        """Return which variant of its operator a node uses, such as ``5d``; empty by default."""
        return ""


def describe_item(item: ir.Node | ir.Value) -> str:
    """Return the name of a graph value, or the name and operator of a node, for reports."""
    if isinstance(item, ir.Value):
        return item.name or ""
    result_name = item.outputs[0].name if item.outputs else ""
    return f"{item.name or result_name} ({item.op_type})"


def every_node(model: ir.Model) -> Iterator[ir.Node]:
    """Yield every node of an ONNX graph, including the bodies of If, Loop and Scan.

    Nodes of the model's functions are not included: the pipeline inlines functions first.
    """
    yield from model.graph.all_nodes()


def is_op(node: ir.Node | None, *kinds: str) -> bool:
    """Return whether a graph node is one of the named standard ONNX operators."""
    return node is not None and node.domain in MAIN_DOMAIN and node.op_type in kinds


def opset_of(model: ir.Model) -> int:
    """Return the version of the ONNX operator set that a model imports; 0 without an import."""
    opset_imports = model.opset_imports
    return next((opset_imports[domain] for domain in MAIN_DOMAIN if domain in opset_imports), 0)


def kernel_dtype(node: ir.Node) -> str:
    """Return the dtype that selects a node's kernel in a runtime; empty if unknown."""
    position = KERNEL_TYPE_INPUT.get(node.op_type, 0)
    values = [*node.inputs[position : position + 1], *node.outputs[:1]]
    kinds = (value.dtype for value in values if value is not None)
    return next((str(kind.numpy()) for kind in kinds if kind is not None), "")

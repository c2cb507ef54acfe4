"""What every rewrite has: a name, a reason, how exact it is, and which targets want it.

A rewrite is a pass over onnx-ir in a file of its own. Its docstring says why it is there and shows
what it does; the page in the documentation is made from it. It is listed in
:mod:`gsgen.sdk.passes.registry` and run by :mod:`gsgen.sdk.rewriting.rewrite`.
"""

__all__ = [
    "BITS",
    "SAFE_WIDTH",
    "ByTables",
    "ErrorBudget",
    "NodeRewrite",
    "Rewrite",
    "RewriteTarget",
    "Substitute",
    "WithinLimit",
    "every_node",
    "is_op",
    "kernel_dtype",
    "opset_of",
]

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Self

import onnx_ir as ir
from onnx_ir import passes

from gsgen.contract.spec.manifest import Manifest
from gsgen.contract.spec.operator_tables import CAPTURE, OperatorTable, operator_table
from gsgen.contract.spec.targets import Target, known_targets

MAIN_DOMAIN = ("", "ai.onnx")
# WebGPU guarantees eight storage buffers a stage, and one of them is that of the whole.
SAFE_WIDTH = 7
_KERNEL_ARGUMENT = {"OneHot": 2, "Where": 1}


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """How far outputs may differ after a rewrite; by default in no bit.

    Attributes:
        relative: Allowed error over the largest number in the output's tensor.
        absolute: Allowed error besides.
        repairs_nonfinite: A value that was NaN or infinite before may become any number.
        pads: Rows of zeros may stand behind the rows of an output.
    """

    relative: float = 0.0
    absolute: float = 0.0
    repairs_nonfinite: bool = False
    pads: bool = False

    @property
    def bits(self) -> bool:
        """Whether every bit is kept."""
        return self == BITS

    def describe(self) -> str:
        """Say it in words."""
        if not (self.relative or self.absolute):
            return (
                "every finite value keeps its bits"
                if self.repairs_nonfinite
                else "bit for bit"
            )
        parts = [f"{self.relative:g} of the largest value"] if self.relative else []
        parts += [f"{self.absolute:g}"] if self.absolute else []
        behind = ", with zeros behind" if self.pads else ""
        return "within " + " and ".join(parts) + behind

    def __or__(self, other: "ErrorBudget") -> "ErrorBudget":
        return ErrorBudget(
            self.relative + other.relative,
            self.absolute + other.absolute,
            self.repairs_nonfinite or other.repairs_nonfinite,
            self.pads or other.pads,
        )


BITS = ErrorBudget()


@dataclass(frozen=True, slots=True)
class RewriteTarget:
    """What a model is rewritten for.

    Attributes:
        target: The consumer.
        tables: What its releases have kernels for. A target that names none is any consumer: then
            these are all tables that are known.
        limits: Its limits, such as ``concat_inputs``; of any consumer, the lowest that are known.
        manifest: What the model says of itself; None where it has no manifest.
        opset: Operator set wished for; None where the kernels decide.
        sizes: Symbolic dimension → the size to give it.
    """

    target: Target
    tables: tuple[OperatorTable, ...] = ()
    limits: Mapping[str, int] = field(default_factory=dict)
    manifest: Manifest | None = None
    opset: int | None = None
    sizes: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        target: Target,
        manifest: Manifest | None = None,
        opset: int | None = None,
        sizes: Mapping[str, int] | None = None,
    ) -> "RewriteTarget":
        """Return the goal of suiting ``target``, or every known target if it names no kernels."""
        meant = [target] if target.operators else [*known_targets().values(), target]
        names = sorted({name for one in meant for name in one.operators})
        limits: dict[str, int] = {}
        for one in meant:
            for name, number in one.limits.items():
                limits[name] = min(number, limits.get(name, number))
        tables = tuple(operator_table(name) for name in names)
        return cls(target, tables, limits, manifest, opset, sizes or {})

    def lacks(self, node: ir.Node, opset: int, variant: str = "") -> bool:
        """Say whether a release of the target is known not to capture ``node``."""
        dtype = kernel_dtype(node)
        outcomes = (t.outcome(node.op_type, variant, dtype, opset) for t in self.tables)
        return any(outcome not in ("", CAPTURE) for outcome in outcomes)


class Rewrite(passes.InPlacePass):
    """A pass that may be named on the command line.

    Its first line says what it does, its body why, with a picture. Attributes of the class:

    * ``name``: what ``--pass`` and ``--skip`` take, such as ``chunk-concat``;
    * ``exactness``: how far outputs may differ;
    * ``wanted_by``: which targets want it, for people; :meth:`for_goal` decides.
    """

    name: ClassVar[str]
    exactness: ClassVar[ErrorBudget] = BITS
    wanted_by: ClassVar[str] = "every target"

    def __init__(self) -> None:
        super().__init__()
        self.changed: list[str] = []
        self.opset = 0

    @classmethod
    def for_goal(cls, goal: RewriteTarget) -> Self | None:
        """Return the pass that serves ``goal``; None where it wants none."""
        return cls()

    @classmethod
    def summary(cls) -> str:
        """The first sentence of the docstring."""
        return (cls.__doc__ or "").strip().split("\n", 1)[0].rstrip(".")

    def call(self, model: ir.Model) -> passes.PassResult:
        """Rewrite ``model``; :attr:`changed` then names what was changed.

        :attr:`opset` is the operator set that it imports.
        """
        self.changed, self.opset = [], opset_of(model)
        self.rewrite(model)
        return passes.PassResult(model, modified=bool(self.changed))

    @abstractmethod
    def rewrite(self, model: ir.Model) -> None:
        """Change ``model``, subgraphs included, and :meth:`note` every node that was changed."""

    def note(self, what: ir.Node | ir.Value) -> None:
        """Remember that a node (or an output, or a weight) was rewritten."""
        if isinstance(what, ir.Value):
            self.changed.append(what.name or "")
            return
        made = what.outputs[0].name if what.outputs else ""
        self.changed.append(f"{what.name or made} ({what.op_type})")


class NodeRewrite(Rewrite):
    """A rewrite that looks at one node after the other.

    Nodes are found first and replaced afterwards: replacing must not remove another match.
    """

    def rewrite(self, model: ir.Model) -> None:
        """Replace every node that matches."""
        for node in [node for node in every_node(model) if self.matches(node)]:
            self.note(node)
            self.replace(node)

    @abstractmethod
    def matches(self, node: ir.Node) -> bool:
        """Say whether ``node`` is to be replaced."""

    @abstractmethod
    def replace(self, node: ir.Node) -> None:
        """Replace ``node``."""


class ByTables(Rewrite):
    """A rewrite that looks up in the target's tables what has a kernel.

    Made without a goal, it rewrites all that it can.
    """

    def __init__(self, goal: RewriteTarget | None = None) -> None:
        super().__init__()
        self.goal = goal

    @classmethod
    def for_goal(cls, goal: RewriteTarget) -> Self | None:
        """Return the pass; without tables there is nothing to suit."""
        return cls(goal) if goal.tables else None


class WithinLimit(Rewrite):
    """A rewrite of operators that are wider than the target can bind.

    Attributes:
        limited_by: Name of the target's limit.
        limit: How many buffers one operator may join, or make.
    """

    limited_by: ClassVar[str]

    def __init__(self, limit: int = SAFE_WIDTH) -> None:
        super().__init__()
        if limit < 2:
            raise ValueError(f"limit is {limit}, wanted 2 or more")
        self.limit = limit

    @classmethod
    def for_goal(cls, goal: RewriteTarget) -> Self | None:
        """Return the pass for the target's limit; None where it has none."""
        limit = goal.limits.get(cls.limited_by)
        return None if limit is None else cls(limit)


class Substitute(ByTables, NodeRewrite):
    """A rewrite of operators that a release of the target does not capture.

    Made without a goal, it replaces every operator that it knows.
    """

    kinds: ClassVar[frozenset[str]]
    wanted_by: ClassVar[str] = "targets whose tables lack the operator"

    def matches(self, node: ir.Node) -> bool:
        """Say whether a release does not capture ``node``, and this pass can replace it."""
        if not is_op(node, *self.kinds):
            return False
        if self.goal is not None and not self.goal.lacks(
            node, self.opset, self.variant(node)
        ):
            return False
        return self.suits(node)

    def suits(self, node: ir.Node) -> bool:
        """Say whether all is known that replacing ``node`` takes."""
        return True

    def variant(self, node: ir.Node) -> str:
        """Return which measured variant of its operator ``node`` is; empty for the usual one."""
        return ""


def every_node(model: ir.Model) -> Iterator[ir.Node]:
    """Yield every node of the main graph and of the bodies of If, Loop and Scan.

    Functions of the model are not looked into: the pipeline writes them out first.
    """
    yield from model.graph.all_nodes()


def is_op(node: ir.Node | None, *kinds: str) -> bool:
    """Say whether ``node`` is one of these standard operators."""
    return node is not None and node.domain in MAIN_DOMAIN and node.op_type in kinds


def opset_of(model: ir.Model) -> int:
    """Return the ONNX operator set that ``model`` imports; 0 if it imports none."""
    imports = model.opset_imports
    return next((imports[domain] for domain in MAIN_DOMAIN if domain in imports), 0)


def kernel_dtype(node: ir.Node) -> str:
    """Return the dtype that chooses the kernel of ``node``; empty if it is not known."""
    place = _KERNEL_ARGUMENT.get(node.op_type, 0)
    values = [*node.inputs[place : place + 1], *node.outputs[:1]]
    kinds = (value.dtype for value in values if value is not None)
    return next((str(kind.numpy()) for kind in kinds if kind is not None), "")

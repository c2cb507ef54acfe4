"""Graph rewrites with preconditions, which record each node left unchanged, and why."""

__all__ = ["CautiousNodeRewrite", "Refusal", "SkippableRewrite"]

from abc import abstractmethod
from dataclasses import dataclass

import onnx_ir as ir
from onnx_ir import passes

from gsgen.sdk.passes.framework.base import NodeRewrite, Rewrite, describe_item, every_node


@dataclass(frozen=True, slots=True)
class Refusal:
    """A node, weight or output that a graph rewrite left unchanged, and the reason."""

    rewrite: str  # name of the rewrite
    where: str  # name of the node, weight or output; a node with its operator
    reason: str  # the precondition that could not be proven


class SkippableRewrite(Rewrite):
    """A graph rewrite that leaves nodes unchanged unless its preconditions are proven.

    Attributes:
        refusals: What the last call left unchanged, in the order of the graph.
    """

    def __init__(self) -> None:
        super().__init__()
        self.refusals: list[Refusal] = []

    def call(self, model: ir.Model) -> passes.PassResult:
        """Rewrite a model in place, and record the nodes left unchanged in :attr:`refusals`."""
        self.refusals = []
        return super().call(model)

    def refuse(self, item: ir.Node | ir.Value, reason: str) -> None:
        """Record that a node, output or weight of the graph stays unchanged, with the reason."""
        self.refusals.append(Refusal(self.name, describe_item(item), reason))


class CautiousNodeRewrite(SkippableRewrite, NodeRewrite):
    """A graph rewrite of single nodes; nodes that cannot be replaced stay, with a reason."""

    def rewrite(self, model: ir.Model) -> None:
        """Replace every matching node, also in subgraphs; record why some cannot be replaced."""
        for node in [node for node in every_node(model) if self.matches(node)]:
            obstacle = self.obstacle(node)
            if obstacle:
                self.refuse(node, obstacle)
                continue
            self.note(node)
            self.replace(node)

    @abstractmethod
    def obstacle(self, node: ir.Node) -> str:
        """Return why the rewrite cannot replace a node; empty if it can."""

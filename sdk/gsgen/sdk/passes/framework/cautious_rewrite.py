"""Rewrites with preconditions, which record every node that they did not rewrite and the reason."""

__all__ = ["CautiousRewrite", "Refusal"]

from dataclasses import dataclass

import onnx_ir as ir
from onnx_ir import passes

from gsgen.sdk.passes.framework.base import Rewrite, describe_item


@dataclass(frozen=True, slots=True)
class Refusal:
    """A node, weight or output that a rewrite left unchanged, and the missing precondition."""

    rewrite: str  # name of the rewrite
    where: str  # name of the node, weight or output; a node with its operator
    reason: str  # the precondition that could not be proven


class CautiousRewrite(Rewrite):
    """A rewrite with preconditions that have to be proven for each node.

    Attributes:
        refusals: What the last call left unchanged, in the order of the graph.
    """

    def __init__(self) -> None:
        super().__init__()
        self.refusals: list[Refusal] = []

    def call(self, model: ir.Model) -> passes.PassResult:
        """Rewrite a model in place, and record the unchanged nodes in :attr:`refusals`."""
        self.refusals = []
        return super().call(model)

    def refuse(self, item: ir.Node | ir.Value, reason: str) -> None:
        """Record that a node, an output or a weight stays unchanged, with the reason."""
        self.refusals.append(Refusal(self.name, describe_item(item), reason))

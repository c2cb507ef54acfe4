"""Rewrites that say what they left as it was, and why."""

__all__ = ["CautiousRewrite", "Refusal"]

from dataclasses import dataclass

import onnx_ir as ir
from onnx_ir import passes

from gsgen.sdk.passes.framework.base import Rewrite


@dataclass(frozen=True, slots=True)
class Refusal:
    """A place that a rewrite left untouched because it could not prove that it may change it.

    Attributes:
        rewrite: Name of the pass.
        where: The node, weight or output, as a person would look for it.
        why: What stood against it.
    """

    rewrite: str
    where: str
    why: str


class CautiousRewrite(Rewrite):
    """A rewrite with preconditions; :attr:`refusals` says where they could not be proven.

    Attributes:
        refusals: What the last call left untouched, in the order of the graph.
    """

    def __init__(self) -> None:
        super().__init__()
        self.refusals: list[Refusal] = []

    def call(self, model: ir.Model) -> passes.PassResult:
        """Rewrite ``model``; :attr:`refusals` then names what was left alone."""
        self.refusals = []
        return super().call(model)

    def refuse(self, what: ir.Node | ir.Value, why: str) -> None:
        """Remember that a node (or an output, or a weight) stays as it is."""
        if isinstance(what, ir.Value):
            self.refusals.append(Refusal(self.name, what.name or "", why))
            return
        made = what.outputs[0].name if what.outputs else ""
        self.refusals.append(
            Refusal(self.name, f"{what.name or made} ({what.op_type})", why)
        )

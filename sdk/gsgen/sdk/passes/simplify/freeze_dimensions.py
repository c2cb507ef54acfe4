"""Replaces symbolic dimensions by sizes that the user specifies."""

__all__ = ["FreezeDimensions"]

import re
from collections.abc import Iterator, Mapping

import onnx_ir as ir

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite


class FreezeDimensions(SkippableRewrite):
    """Give symbolic dimensions the requested sizes, everywhere in the graph.

    A captured frame has buffers of fixed size, and a reader takes the number of rows from the
    output's shape. Shapes inside the graph that depend on a frozen name are inferred again::

        pose float[J, 3], rows float[N, 10]   →   with J=24, N=1000   →   pose float[24, 3], …

    Nothing changes for inputs with these sizes; the model no longer accepts other sizes.
    """

    name = "freeze-dimensions"
    wanted_by = "users who name a size: `--size N=1000`"

    def __init__(self, sizes: Mapping[str, int]) -> None:
        super().__init__()
        for name, size in sizes.items():
            if size < 1:
                raise ConfigInvalid(
                    f"the size of {name} is {size}, expected 1 or more", where="--size"
                )
        self.sizes = dict(sizes)
        self._frozen_symbols: set[str] = set()

    @classmethod
    def for_target(cls, target: RewriteTarget) -> "FreezeDimensions | None":
        """Return the rewrite, with the user's sizes of symbolic dimensions; None without sizes."""
        return cls(target.sizes) if target.sizes else None

    def rewrite(self, model: ir.Model) -> None:
        """Replace each symbolic dimension for which the user gave a size."""
        names = {dim for value in _values(model) for dim in _symbol_names(value)}
        ends = {*model.graph.inputs, *model.graph.outputs}
        for name in self.sizes.keys() - names - self._frozen_symbols:
            declared_symbols = {dim for value in ends for dim in _symbol_names(value)}
            raise UnknownName.among("dimension", name, declared_symbols, "--size")
        self._frozen_symbols |= names & self.sizes.keys()
        for value in _values(model):
            if value.shape is None:
                continue
            dims = [self._freeze_dim(dim) for dim in value.shape]
            if dims == list(value.shape):
                continue
            value.shape = ir.Shape(dims)
            if value in ends:
                self.note(value)

    def _freeze_dim(self, dim: int | ir.SymbolicDim) -> int | ir.SymbolicDim:
        text = "" if isinstance(dim, int) else dim.value or ""
        if text in self.sizes:
            return self.sizes[text]
        # An expression such as `20 - N` is inferred again, from the sizes that are now known.
        if self.sizes.keys() & set(_words(text)):
            return ir.SymbolicDim(None)
        return dim


def _words(text: str) -> list[str]:
    return re.findall(r"\w+", text)


def _symbol_names(value: ir.Value) -> Iterator[str]:
    for dim in value.shape or ():
        if not isinstance(dim, int) and dim.value:
            yield dim.value
            yield from _words(dim.value)


def _values(model: ir.Model) -> Iterator[ir.Value]:
    """Yield every value of the model, those of subgraphs included."""
    for graph in (model.graph, *model.graph.subgraphs()):
        yield from graph.inputs
        yield from (value for node in graph for value in node.outputs)
        yield from (value for value in graph.outputs if value.producer() is None)

"""Weights that are held once."""

__all__ = ["DeduplicateWeights"]

import hashlib
from collections import ChainMap, Counter
from collections.abc import Hashable, Iterator
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite

_CHUNK = 1 << 24


class DeduplicateWeights(CautiousRewrite):
    """Hold every weight once that stands in the graph several times.

    A tied table, or a constant that an exporter writes anew at each use, is stored, downloaded
    and uploaded as often as it stands there::

        Add(x, ones), Mul(y, ones_1)   →   Add(x, ones), Mul(y, ones)

    Weights are one if dtype, shape and every byte are equal: 0 and −0 are two, and so are NaNs of
    other bits. Bytes are read only where dtype and shape agree, a part at a time; two weights that
    refer to the same place of a file beside the model are one without being read.
    """

    name: ClassVar[str] = "share-weights"

    def rewrite(self, model: ir.Model) -> None:
        """Let each weight's readers read its first copy that they can see."""
        graphs = (model.graph, *model.graph.subgraphs())
        weights = [value for graph in graphs for value in graph.initializers.values()]
        self._often = Counter(_outline(value) for value in weights)
        self._digests: dict[Hashable, bytes] = {}
        self._share(model.graph, ChainMap())

    def _share(self, graph: ir.Graph, known: "ChainMap[Hashable, ir.Value]") -> None:
        """Share the weights of ``graph`` and of its subgraphs; ``known`` are those outside."""
        for name, value in list(graph.initializers.items()):
            if self._often[_outline(value)] < 2 or not self._may_go(value):
                continue
            first = known.setdefault(self._content(value), value)
            if first is not value and not value.is_graph_output():
                ir.convenience.replace_all_uses_with(value, first)
                self.note(value)
                del graph.initializers[name]
        for node in graph:
            for body in _bodies(node):
                self._share(body, known.new_child())

    def _may_go(self, value: ir.Value) -> bool:
        tensor = value.const_value
        if tensor is None or tensor.dtype.is_string():
            return False
        if value.is_graph_input():
            self.refuse(value, "it is an input, too, so another value can be fed")
            return False
        return True

    def _content(self, value: ir.Value) -> Hashable:
        """Return what two weights share exactly if dtype, shape and bytes are equal."""
        tensor = value.const_value
        place: Hashable = None
        if isinstance(tensor, ir.ExternalTensor):
            place = (tensor.path, tensor.offset, tensor.length)
        digest = self._digests.get(place) or _digest(tensor)
        if place is not None:
            self._digests[place] = digest
        return _outline(value), digest


def _digest(tensor: ir.TensorProtocol | None) -> bytes:
    digest = hashlib.sha256()
    for part in _parts(tensor):
        digest.update(part)
    return digest.digest()


def _outline(value: ir.Value) -> Hashable:
    tensor = value.const_value
    return None if tensor is None else (tensor.dtype, tuple(tensor.shape.numpy()))


def _bodies(node: ir.Node) -> Iterator[ir.Graph]:
    for attribute in node.attributes.values():
        if attribute.type == ir.AttributeType.GRAPH:
            yield attribute.as_graph()
        elif attribute.type == ir.AttributeType.GRAPHS:
            yield from attribute.as_graphs()


def _parts(tensor: ir.TensorProtocol | None) -> Iterator[memoryview]:
    """Yield the bytes of a tensor, 16 MiB at a time; one in a file is mapped, not read at once."""
    assert tensor is not None
    flat = np.ascontiguousarray(tensor.numpy()).reshape(-1).view(np.uint8)
    for start in range(0, flat.size, _CHUNK):
        yield flat[start : start + _CHUNK].data

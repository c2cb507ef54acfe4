"""Merges weights of a graph that have equal bytes."""

__all__ = ["DeduplicateWeights"]

import hashlib
from collections import ChainMap, Counter
from collections.abc import Hashable, Iterator

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite

_CHUNK_BYTES = 1 << 24


class DeduplicateWeights(SkippableRewrite):
    """Merge weights of the graph that are equal in dtype, shape and bytes.

    A tied table, or a constant that an exporter writes again at each use, is stored, downloaded
    and uploaded as often as it occurs::

        Add(x, ones), Mul(y, ones_1)   →   Add(x, ones), Mul(y, ones)

    Weights are equal if dtype, shape and every byte are equal: 0 and −0 differ, and so do NaNs with
    different bits. Bytes are read only if dtype and shape agree, in parts; two weights that refer
    to the same location in an external file are equal without being read.
    """

    name = "share-weights"

    def rewrite(self, model: ir.Model) -> None:
        """Let all nodes that read equal weights read the first copy that is in scope."""
        graphs = (model.graph, *model.graph.subgraphs())
        weights = [value for graph in graphs for value in graph.initializers.values()]
        self._occurrences = Counter(_weight_key(value) for value in weights)
        self._digests: dict[Hashable, bytes] = {}
        self._share_weights(model.graph, ChainMap())

    def _share_weights(self, graph: ir.Graph, known: "ChainMap[Hashable, ir.Value]") -> None:
        """Merge equal weights of a graph, its subgraphs and the graphs around it."""
        for name, value in list(graph.initializers.items()):
            if self._occurrences[_weight_key(value)] < 2 or not self._can_merge(value):
                continue
            first = known.setdefault(self._content(value), value)
            if first is not value and not value.is_graph_output():
                ir.convenience.replace_all_uses_with(value, first)
                self.note(value)
                del graph.initializers[name]
        for node in graph:
            for body in _subgraphs_of_node(node):
                self._share_weights(body, known.new_child())

    def _can_merge(self, value: ir.Value) -> bool:
        tensor = value.const_value
        if tensor is None or tensor.dtype.is_string():
            return False
        if value.is_graph_input():
            self.refuse(value, "it is also an input, so callers can feed another value")
            return False
        return True

    def _content(self, value: ir.Value) -> Hashable:
        """Return a key that is the same for weights with equal dtype, shape and bytes."""
        tensor = value.const_value
        location: Hashable = None
        if isinstance(tensor, ir.ExternalTensor):
            location = (tensor.path, tensor.offset, tensor.length)
        digest = self._digests.get(location) or _digest(tensor)
        if location is not None:
            self._digests[location] = digest
        return _weight_key(value), digest


def _digest(tensor: ir.TensorProtocol | None) -> bytes:
    digest = hashlib.sha256()
    for part in _parts(tensor):
        digest.update(part)
    return digest.digest()


def _weight_key(value: ir.Value) -> Hashable:
    tensor = value.const_value
    return None if tensor is None else (tensor.dtype, tuple(tensor.shape.numpy()))


def _subgraphs_of_node(node: ir.Node) -> Iterator[ir.Graph]:
    for attribute in node.attributes.values():
        if attribute.type == ir.AttributeType.GRAPH:
            yield attribute.as_graph()
        elif attribute.type == ir.AttributeType.GRAPHS:
            yield from attribute.as_graphs()


def _parts(tensor: ir.TensorProtocol | None) -> Iterator[memoryview]:
    """Yield the bytes of a weight in parts of 16 MiB; external weights are memory-mapped."""
    assert tensor is not None
    flat = np.ascontiguousarray(tensor.numpy()).reshape(-1).view(np.uint8)
    for start in range(0, flat.size, _CHUNK_BYTES):
        yield flat[start : start + _CHUNK_BYTES].data

"""Updates of a part of a tensor, without writing into a buffer that others read."""

__all__ = ["GatherScatters"]

import math
from typing import ClassVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, fixed_shape, int_attribute

_LARGEST = 1 << 24


class GatherScatters(CautiousRewrite):
    """Write a Scatter whose places are known by joining old and new and gathering from both.

    ScatterND and ScatterElements update in place. Where their base is an input or a weight, or is
    read by others too, a captured graph is wrong from its first frame on, without any error; and
    onnxruntime-web 1.22 has no right kernel at all. torch exports them for ``x[:, 0] = y``::

        ScatterND(x, places, y)   →   Gather(Concat(x, y), for each element the last that was put there)
    """

    name: ClassVar[str] = "gather-scatters"
    wanted_by: ClassVar[str] = "every target"

    def rewrite(self, model: ir.Model) -> None:
        """Rewrite every scatter whose places and shapes are known."""
        for node in list(model.graph.all_nodes()):
            if not is_op(node, "ScatterElements", "ScatterND"):
                continue
            why = _unknown(node)
            if why:
                self.refuse(node, why)
                continue
            self.note(node)
            _replace(node)


def _unknown(node: ir.Node) -> str:
    """Say what stands against rewriting ``node``; nothing if nothing does."""
    reduction = node.attributes.get("reduction")
    if reduction is not None and reduction.as_string() != "none":
        return f"it does not replace elements: its reduction is {reduction.as_string()!r}"
    if constant_of(node.inputs[1], largest=_LARGEST) is None:
        return "the places it updates are not known before the frame"
    shape = fixed_shape(node.inputs[0])
    if shape is None:
        return "the shape of what it updates is not known"
    return "what it updates is empty" if 0 in shape else ""


def _replace(node: ir.Node) -> None:
    write = InsertionPoint(node)
    data, _, updates = node.inputs
    places, shape = constant_of(node.inputs[1], largest=_LARGEST), fixed_shape(data)
    assert places is not None
    assert shape is not None
    if is_op(node, "ScatterND"):
        depth = places.shape[-1]
        rest = shape[depth:]
        flat = _flat(places, shape[:depth])
    else:
        axis = int_attribute(node, "axis", 0) % len(shape)
        index = np.indices(places.shape)
        index[axis] = np.where(places < 0, places + shape[axis], places)
        rest, flat = (), _flat(np.moveaxis(index, 0, -1), shape)
    rows = math.prod(shape) // max(math.prod(rest), 1) if math.prod(rest) else 0
    order = np.arange(rows, dtype=np.int64)
    # Of several updates of one place, the last one holds; numpy assigns in this order.
    order[flat.reshape(-1)] = rows + np.arange(flat.size)
    old = write.op("Reshape", data, write.whole(rows, *rest))
    new = write.op("Reshape", updates, write.whole(flat.size, *rest))
    both = write.op("Concat", old, new, axis=0)
    taken = write.op("Gather", both, write.constant(order, "order"), axis=0)
    write.replace(write.op("Reshape", taken, write.whole(*shape)))


def _flat(places: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """Return one number for each place in axes of ``sizes``; negative ones count from behind."""
    flat = np.zeros(places.shape[:-1], np.int64)
    for axis, size in enumerate(sizes):
        place = places[..., axis]
        flat = flat * size + np.where(place < 0, place + size, place)
    return flat

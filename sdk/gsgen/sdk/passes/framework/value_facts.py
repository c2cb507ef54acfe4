"""What is known of a value before the first frame: its shape, and what it holds."""

__all__ = ["constant_of", "fixed_shape", "int_attribute", "rank_of", "split_sizes"]

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.graph_builder import known_array

_LARGEST = 1 << 16


def fixed_shape(value: ir.Value | None) -> tuple[int, ...] | None:
    """Return the shape of ``value`` where every axis has a number."""
    if value is None or value.shape is None:
        return None
    dims = tuple(dim for dim in value.shape if isinstance(dim, int))
    return dims if len(dims) == len(value.shape) else None


def rank_of(value: ir.Value | None) -> int | None:
    """Return how many axes ``value`` has, where that is known."""
    return None if value is None or value.shape is None else len(value.shape)


def constant_of(value: ir.Value | None, largest: int = _LARGEST) -> np.ndarray | None:
    """Return what ``value`` holds at every frame; None where that varies, or has many elements.

    A weight that is also an input of the graph can be fed: it is no constant.
    """
    if value is None or value.is_graph_input():
        return None
    if value.const_value is not None and value.const_value.size > largest:
        return None
    if value.const_value is not None and value.const_value.dtype.is_string():
        return None
    array = known_array(value)
    return array if array is None or array.size <= largest else None


def int_attribute(node: ir.Node, name: str, default: int) -> int:
    """Return an integer attribute, or ``default`` where the node does not have it."""
    attribute = node.attributes.get(name)
    return default if attribute is None else int(attribute.as_int())


def split_sizes(node: ir.Node) -> list[int] | None:
    """Return the sizes of the parts that a Split returns; None where they are not known."""
    given = node.attributes.get("split")
    if given is not None:
        return list(given.as_ints())
    if len(node.inputs) > 1 and node.inputs[1] is not None:
        known = constant_of(node.inputs[1])
        return None if known is None else [int(size) for size in known]
    value = node.inputs[0]
    if value is None or value.shape is None:
        return None
    axis = node.attributes["axis"].as_int() if "axis" in node.attributes else 0
    whole, count = value.shape[axis], len(node.outputs)
    if not isinstance(whole, int):
        return None
    part = -(-whole // count)
    last = whole - part * (count - 1)
    return None if last < 0 else [part] * (count - 1) + [last]

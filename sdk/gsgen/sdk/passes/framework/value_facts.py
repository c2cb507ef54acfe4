"""Facts about graph values that are known before the first frame: shapes, constants."""

__all__ = [
    "UNBOUNDED_END", "attribute_values", "constant_of", "fixed_shape", "int_attribute",
    "numpy_dtype", "rank_of", "required", "split_sizes",
]  # fmt: skip

from typing import Any, TypeVar

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.graph_builder import constant_array

_MAX_ELEMENTS = 1 << 16
_FactType = TypeVar("_FactType")

# A Slice ends at or above this index to mean the end of the axis.
UNBOUNDED_END = (1 << 31) - 1


def required(fact: _FactType | None) -> _FactType:
    """Return a value that an earlier check has shown not to be None."""
    assert fact is not None
    return fact


def numpy_dtype(value: ir.Value) -> np.dtype:
    """Return the NumPy dtype of a graph value whose dtype is known."""
    return required(value.dtype).numpy()


def fixed_shape(value: ir.Value | None) -> tuple[int, ...] | None:
    """Return the shape of a graph value if every axis has a fixed size; else None."""
    if value is None or value.shape is None:
        return None
    dims = tuple(dim for dim in value.shape if isinstance(dim, int))
    return dims if len(dims) == len(value.shape) else None


def rank_of(value: ir.Value | None) -> int | None:
    """Return the number of axes of a graph value; None if the number is unknown."""
    return None if value is None or value.shape is None else len(value.shape)


def constant_of(value: ir.Value | None, largest: int = _MAX_ELEMENTS) -> np.ndarray | None:
    """Return the array of a constant graph value; None if it is not constant or too large.

    A weight that is also an input of the graph is not constant: callers can feed it.
    """
    if value is None or value.is_graph_input():
        return None
    if value.const_value is not None and value.const_value.size > largest:
        return None
    if value.const_value is not None and value.const_value.dtype.is_string():
        return None
    array = constant_array(value)
    return array if array is None or array.size <= largest else None


def int_attribute(node: ir.Node, name: str, default: int) -> int:
    """Return an integer attribute of a node, or ``default`` if the node lacks it."""
    attribute = node.attributes.get(name)
    return default if attribute is None else int(attribute.as_int())


def attribute_values(node: ir.Node) -> dict[str, Any]:
    """Return the attributes of a node as Python values, by name."""
    return {name: attribute.value for name, attribute in node.attributes.items()}


def split_sizes(node: ir.Node) -> list[int] | None:
    """Return the sizes of the outputs of a Split node; None if unknown."""
    attribute = node.attributes.get("split")
    if attribute is not None:
        return list(attribute.as_ints())
    if len(node.inputs) > 1 and node.inputs[1] is not None:
        known = constant_of(node.inputs[1])
        return None if known is None else [int(size) for size in known]
    value = node.inputs[0]
    if value is None or value.shape is None:
        return None
    axis = node.attributes["axis"].as_int() if "axis" in node.attributes else 0
    length, count = value.shape[axis], len(node.outputs)
    if not isinstance(length, int):
        return None
    part = -(-length // count)
    last_size = length - part * (count - 1)
    return None if last_size < 0 else [part] * (count - 1) + [last_size]

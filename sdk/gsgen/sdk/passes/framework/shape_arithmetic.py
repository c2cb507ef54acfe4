"""Operators that shapes are computed with, in NumPy: exact, or not at all."""

__all__ = ["evaluate"]

from collections.abc import Callable, Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.value_facts import int_attribute

Arrays = Sequence[np.ndarray | None]


def evaluate(node: ir.Node, inputs: Arrays) -> np.ndarray | None:
    """Return what ``node`` gives for ``inputs``; None where that is not exact, or an error.

    Whole numbers and booleans are computed with; other numbers are moved, compared and cast, and
    never added or multiplied, because another machine rounds another way.
    """
    known = [array for array in inputs if array is not None]
    found = _MOVES.get(node.op_type)
    if found is None and all(array.dtype.kind in "iub" for array in known):
        found = _OF_WHOLE.get(node.op_type)
    if found is None:
        return None
    with np.errstate(all="raise"):
        try:
            return found(node, inputs)
        except (FloatingPointError, IndexError, TypeError, ValueError, ZeroDivisionError):
            return None  # the runtime reports what is wrong with it, with its own words


def _of_two(compute: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> "Evaluator":
    def run(_: ir.Node, inputs: Arrays) -> np.ndarray:
        first, second = inputs
        assert first is not None
        assert second is not None
        return np.asarray(compute(first, second))

    return run


def _of_many(compute: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> "Evaluator":
    def run(_: ir.Node, inputs: Arrays) -> np.ndarray:
        made, *others = [array for array in inputs if array is not None]
        for other in others:
            made = np.asarray(compute(made, other))
        return made

    return run


def _of_one(compute: Callable[[np.ndarray], np.ndarray]) -> "Evaluator":
    def run(_: ir.Node, inputs: Arrays) -> np.ndarray:
        assert inputs[0] is not None
        return np.asarray(compute(inputs[0]))

    return run


def _divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Divide whole numbers and round towards zero, as C does."""
    if not np.all(b):
        raise ZeroDivisionError
    quotient = np.abs(a) // np.abs(b)
    return np.asarray(np.where((a < 0) != (b < 0), -quotient, quotient), a.dtype)


def _modulo(node: ir.Node, inputs: Arrays) -> np.ndarray:
    a, b = inputs
    assert a is not None
    assert b is not None
    if not np.all(b):
        raise ZeroDivisionError
    return np.asarray(np.fmod(a, b) if int_attribute(node, "fmod", 0) else np.mod(a, b))


def _axes(node: ir.Node, inputs: Arrays, place: int = 1) -> tuple[int, ...] | None:
    """Return the axes, which older operator sets have as an attribute."""
    if "axes" in node.attributes:
        return tuple(int(axis) for axis in node.attributes["axes"].as_ints())
    array = inputs[place] if place < len(inputs) else None
    return None if array is None else tuple(int(axis) for axis in array.reshape(-1))


def _first(inputs: Arrays) -> np.ndarray:
    assert inputs[0] is not None
    return inputs[0]


def _reduce(compute: Callable[..., np.ndarray]) -> "Evaluator":
    def run(node: ir.Node, inputs: Arrays) -> np.ndarray:
        axes, array = _axes(node, inputs), _first(inputs)
        if not axes and int_attribute(node, "noop_with_empty_axes", 0):
            return array
        keep = bool(int_attribute(node, "keepdims", 1))
        made = compute(array, axis=axes or None, keepdims=keep)
        return np.asarray(made, array.dtype)

    return run


def _squeeze(node: ir.Node, inputs: Arrays) -> np.ndarray:
    return np.squeeze(_first(inputs), _axes(node, inputs))


def _unsqueeze(node: ir.Node, inputs: Arrays) -> np.ndarray:
    axes = _axes(node, inputs)
    assert axes is not None
    return np.expand_dims(_first(inputs), axes)


def _reshape(node: ir.Node, inputs: Arrays) -> np.ndarray:
    array, shape = _first(inputs), inputs[1]
    assert shape is not None
    sizes = [int(size) for size in shape]
    if not int_attribute(node, "allowzero", 0):
        sizes = [size or array.shape[place] for place, size in enumerate(sizes)]
    return array.reshape(sizes)


def _gather(node: ir.Node, inputs: Arrays) -> np.ndarray:
    index = inputs[1]
    assert index is not None
    return np.asarray(np.take(_first(inputs), index, axis=int_attribute(node, "axis", 0)))


def _slice(node: ir.Node, inputs: Arrays) -> np.ndarray:
    array = _first(inputs)
    if len(inputs) < 3:
        raise TypeError  # operator set 9 and before: attributes
    assert inputs[1] is not None
    assert inputs[2] is not None
    starts, ends = inputs[1].tolist(), inputs[2].tolist()
    axes = _axes(node, inputs, 3) or tuple(range(len(starts)))
    given = inputs[4] if len(inputs) > 4 else None
    steps = [1] * len(starts) if given is None else given.tolist()
    cut = [slice(None)] * array.ndim
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        size = array.shape[axis]
        # Below −size a backward slice ends before the first element, which Python spells None;
        # and it starts at the first one, where Python's would be empty.
        stop = None if step < 0 and end < -size else end
        cut[axis] = slice(max(start, -size), stop, step)
    return array[tuple(cut)]


def _cast(node: ir.Node, inputs: Arrays) -> np.ndarray:
    array, kind = _first(inputs), ir.DataType(node.attributes["to"].as_int())
    if kind.is_string():
        raise TypeError
    dtype = kind.numpy()
    if array.dtype.kind == "f" and dtype.kind in "iu":
        whole = np.trunc(array.astype(np.float64))
        limits = np.iinfo(dtype)
        if not ((whole >= limits.min) & (whole < float(limits.max))).all():
            raise ValueError  # what such a cast gives is up to the machine
    return array.astype(dtype)


def _concat(node: ir.Node, inputs: Arrays) -> np.ndarray:
    parts = [array for array in inputs if array is not None]
    return np.concatenate(parts, axis=node.attributes["axis"].as_int())


def _where(_: ir.Node, inputs: Arrays) -> np.ndarray:
    chosen, yes, no = inputs
    assert chosen is not None
    assert yes is not None
    assert no is not None
    return np.asarray(np.where(chosen, yes, no))


def _expand(_: ir.Node, inputs: Arrays) -> np.ndarray:
    array, shape = _first(inputs), inputs[1]
    assert shape is not None
    whole = np.broadcast_shapes(array.shape, tuple(int(size) for size in shape))
    return np.broadcast_to(array, whole)


def _transpose(node: ir.Node, inputs: Arrays) -> np.ndarray:
    order = node.attributes.get("perm")
    return _first(inputs).transpose(None if order is None else list(order.as_ints()))


def _constant_of_shape(node: ir.Node, inputs: Arrays) -> np.ndarray:
    value = node.attributes.get("value")
    filler = np.zeros(1, np.float32) if value is None else value.as_tensor().numpy()
    return np.full([int(size) for size in _first(inputs)], filler.reshape(-1)[0])


def _range(_: ir.Node, inputs: Arrays) -> np.ndarray:
    start, limit, step = (array.reshape(()) for array in inputs if array is not None)
    if start.dtype.kind == "f" and not _is_whole(start, limit, step):
        raise ValueError  # start + i · step rounds in its own way
    count = max(0, int(np.ceil((float(limit) - float(start)) / float(step))))
    return (start + np.arange(count) * step).astype(start.dtype)


def _is_whole(*numbers: np.ndarray) -> bool:
    return all(float(number).is_integer() and abs(number) < 1 << 24 for number in numbers)


Evaluator = Callable[[ir.Node, Arrays], np.ndarray]
_MOVES: dict[str, Evaluator] = {
    "Cast": _cast,
    "Concat": _concat,
    "ConstantOfShape": _constant_of_shape,
    "Equal": _of_two(np.equal),
    "Expand": _expand,
    "Gather": _gather,
    "Greater": _of_two(np.greater),
    "GreaterOrEqual": _of_two(np.greater_equal),
    "Identity": _of_one(lambda a: a),
    "Less": _of_two(np.less),
    "LessOrEqual": _of_two(np.less_equal),
    "Range": _range,
    "Reshape": _reshape,
    "Slice": _slice,
    "Squeeze": _squeeze,
    "Transpose": _transpose,
    "Unsqueeze": _unsqueeze,
    "Where": _where,
}
_OF_WHOLE: dict[str, Evaluator] = {
    "Abs": _of_one(np.abs),
    "Add": _of_two(np.add),
    "And": _of_two(np.logical_and),
    "Div": _of_two(_divide),
    "Max": _of_many(np.maximum),
    "Min": _of_many(np.minimum),
    "Mod": _modulo,
    "Mul": _of_two(np.multiply),
    "Neg": _of_one(np.negative),
    "Not": _of_one(np.logical_not),
    "Or": _of_two(np.logical_or),
    "ReduceMax": _reduce(np.max),
    "ReduceMin": _reduce(np.min),
    "ReduceProd": _reduce(np.prod),
    "ReduceSum": _reduce(np.sum),
    "Sub": _of_two(np.subtract),
    "Xor": _of_two(np.logical_xor),
}

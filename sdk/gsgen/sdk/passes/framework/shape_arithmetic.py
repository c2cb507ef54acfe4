"""Evaluates ONNX operators that compute shapes in NumPy; inexact results are refused."""

__all__ = ["evaluate"]

from collections.abc import Callable, Sequence

import numpy as np
import onnx_ir as ir

from gsgen.sdk.passes.framework.value_facts import int_attribute, required

Arrays = Sequence[np.ndarray | None]


def evaluate(node: ir.Node, inputs: Arrays) -> np.ndarray | None:
    """Evaluate an ONNX node on integers in NumPy; None if the result is inexact or raises an error.

    Arithmetic is limited to integers and booleans. Floats are only moved, compared and cast,
    because sums and products round differently on other machines.
    """
    known = [array for array in inputs if array is not None]
    evaluator = _EVALUATORS_FOR_ANY_DTYPE.get(node.op_type)
    if evaluator is None and all(array.dtype.kind in "iub" for array in known):
        evaluator = _EVALUATORS_FOR_INTEGERS.get(node.op_type)
    if evaluator is None:
        return None
    with np.errstate(all="raise"):
        try:
            return evaluator(node, inputs)
        except (FloatingPointError, IndexError, TypeError, ValueError, ZeroDivisionError):
            return None  # the runtime reports the error itself


def _binary_evaluator(compute: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> "Evaluator":
    def run(_: ir.Node, inputs: Arrays) -> np.ndarray:
        first_input, second_input = inputs
        assert first_input is not None
        assert second_input is not None
        return np.asarray(compute(first_input, second_input))

    return run


def _variadic_evaluator(compute: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> "Evaluator":
    def run(_: ir.Node, inputs: Arrays) -> np.ndarray:
        result, *operands = [array for array in inputs if array is not None]
        for operand in operands:
            result = np.asarray(compute(result, operand))
        return result

    return run


def _unary_evaluator(compute: Callable[[np.ndarray], np.ndarray]) -> "Evaluator":
    def run(_: ir.Node, inputs: Arrays) -> np.ndarray:
        assert inputs[0] is not None
        return np.asarray(compute(inputs[0]))

    return run


def _divide_toward_zero(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Divide integers and round towards zero, as C does."""
    if not np.all(b):
        raise ZeroDivisionError
    quotient = np.abs(a) // np.abs(b)
    return np.asarray(np.where((a < 0) != (b < 0), -quotient, quotient), a.dtype)


def _evaluate_modulo(node: ir.Node, inputs: Arrays) -> np.ndarray:
    a, b = inputs
    assert a is not None
    assert b is not None
    if not np.all(b):
        raise ZeroDivisionError
    return np.asarray(np.fmod(a, b) if int_attribute(node, "fmod", 0) else np.mod(a, b))


def _axes(node: ir.Node, inputs: Arrays, position: int = 1) -> tuple[int, ...] | None:
    """Return a node's axes, from an input or from an attribute of older operator sets."""
    if "axes" in node.attributes:
        return tuple(int(axis) for axis in node.attributes["axes"].as_ints())
    array = inputs[position] if position < len(inputs) else None
    return None if array is None else tuple(int(axis) for axis in array.reshape(-1))


def _first_input(inputs: Arrays) -> np.ndarray:
    assert inputs[0] is not None
    return inputs[0]


def _reduction_evaluator(compute: Callable[..., np.ndarray]) -> "Evaluator":
    def run(node: ir.Node, inputs: Arrays) -> np.ndarray:
        axes, array = _axes(node, inputs), _first_input(inputs)
        if not axes and int_attribute(node, "noop_with_empty_axes", 0):
            return array
        keep_axes = bool(int_attribute(node, "keepdims", 1))
        reduced = compute(array, axis=axes or None, keepdims=keep_axes)
        return np.asarray(reduced, array.dtype)

    return run


def _evaluate_squeeze(node: ir.Node, inputs: Arrays) -> np.ndarray:
    return np.squeeze(_first_input(inputs), _axes(node, inputs))


def _evaluate_unsqueeze(node: ir.Node, inputs: Arrays) -> np.ndarray:
    axes = required(_axes(node, inputs))
    return np.expand_dims(_first_input(inputs), axes)


def _evaluate_reshape(node: ir.Node, inputs: Arrays) -> np.ndarray:
    array, shape = _first_input(inputs), required(inputs[1])
    sizes = [int(size) for size in shape]
    if not int_attribute(node, "allowzero", 0):
        sizes = [size or array.shape[axis] for axis, size in enumerate(sizes)]
    return array.reshape(sizes)


def _evaluate_gather(node: ir.Node, inputs: Arrays) -> np.ndarray:
    index = required(inputs[1])
    return np.asarray(np.take(_first_input(inputs), index, axis=int_attribute(node, "axis", 0)))


def _evaluate_slice(node: ir.Node, inputs: Arrays) -> np.ndarray:
    array = _first_input(inputs)
    if len(inputs) < 3:
        raise TypeError  # operator set 9 and before: attributes
    assert inputs[1] is not None
    assert inputs[2] is not None
    starts, ends = inputs[1].tolist(), inputs[2].tolist()
    axes = _axes(node, inputs, 3) or tuple(range(len(starts)))
    step_input = inputs[4] if len(inputs) > 4 else None
    steps = [1] * len(starts) if step_input is None else step_input.tolist()
    slices = [slice(None)] * array.ndim
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        size = array.shape[axis]
        # Below −size a backward slice ends before the first element, which Python writes as None;
        # it starts at the first element, where a Python slice would be empty.
        stop = None if step < 0 and end < -size else end
        slices[axis] = slice(max(start, -size), stop, step)
    return array[tuple(slices)]


def _evaluate_cast(node: ir.Node, inputs: Arrays) -> np.ndarray:
    array, kind = _first_input(inputs), ir.DataType(node.attributes["to"].as_int())
    if kind.is_string():
        raise TypeError
    dtype = kind.numpy()
    if array.dtype.kind == "f" and dtype.kind in "iu":
        whole = np.trunc(array.astype(np.float64))
        limits = np.iinfo(dtype)
        if not ((whole >= limits.min) & (whole < float(limits.max))).all():
            raise ValueError  # such a cast is undefined and differs between machines
    return array.astype(dtype)


def _evaluate_concat(node: ir.Node, inputs: Arrays) -> np.ndarray:
    parts = [array for array in inputs if array is not None]
    return np.concatenate(parts, axis=node.attributes["axis"].as_int())


def _evaluate_where(_: ir.Node, inputs: Arrays) -> np.ndarray:
    condition, value_if_true, value_if_false = inputs
    assert condition is not None
    assert value_if_true is not None
    assert value_if_false is not None
    return np.asarray(np.where(condition, value_if_true, value_if_false))


def _evaluate_expand(_: ir.Node, inputs: Arrays) -> np.ndarray:
    array, shape = _first_input(inputs), required(inputs[1])
    whole = np.broadcast_shapes(array.shape, tuple(int(size) for size in shape))
    return np.broadcast_to(array, whole)


def _evaluate_transpose(node: ir.Node, inputs: Arrays) -> np.ndarray:
    order = node.attributes.get("perm")
    return _first_input(inputs).transpose(None if order is None else list(order.as_ints()))


def _evaluate_constant_of_shape(node: ir.Node, inputs: Arrays) -> np.ndarray:
    value = node.attributes.get("value")
    fill_value = np.zeros(1, np.float32) if value is None else value.as_tensor().numpy()
    return np.full([int(size) for size in _first_input(inputs)], fill_value.reshape(-1)[0])


def _evaluate_range(_: ir.Node, inputs: Arrays) -> np.ndarray:
    start, limit, step = (array.reshape(()) for array in inputs if array is not None)
    if start.dtype.kind == "f" and not _are_whole_numbers(start, limit, step):
        raise ValueError  # the rounding of start + i · step is not specified
    count = max(0, int(np.ceil((float(limit) - float(start)) / float(step))))
    return (start + np.arange(count) * step).astype(start.dtype)


def _are_whole_numbers(*numbers: np.ndarray) -> bool:
    return all(float(number).is_integer() and abs(number) < 1 << 24 for number in numbers)


Evaluator = Callable[[ir.Node, Arrays], np.ndarray]
_EVALUATORS_FOR_ANY_DTYPE: dict[str, Evaluator] = {
    "Cast": _evaluate_cast,
    "Concat": _evaluate_concat,
    "ConstantOfShape": _evaluate_constant_of_shape,
    "Equal": _binary_evaluator(np.equal),
    "Expand": _evaluate_expand,
    "Gather": _evaluate_gather,
    "Greater": _binary_evaluator(np.greater),
    "GreaterOrEqual": _binary_evaluator(np.greater_equal),
    "Identity": _unary_evaluator(lambda a: a),
    "Less": _binary_evaluator(np.less),
    "LessOrEqual": _binary_evaluator(np.less_equal),
    "Range": _evaluate_range,
    "Reshape": _evaluate_reshape,
    "Slice": _evaluate_slice,
    "Squeeze": _evaluate_squeeze,
    "Transpose": _evaluate_transpose,
    "Unsqueeze": _evaluate_unsqueeze,
    "Where": _evaluate_where,
}
_EVALUATORS_FOR_INTEGERS: dict[str, Evaluator] = {
    "Abs": _unary_evaluator(np.abs), "Add": _binary_evaluator(np.add), "And": _binary_evaluator(np.logical_and),
    "Div": _binary_evaluator(_divide_toward_zero), "Max": _variadic_evaluator(np.maximum), "Min": _variadic_evaluator(np.minimum),
    "Mod": _evaluate_modulo, "Mul": _binary_evaluator(np.multiply), "Neg": _unary_evaluator(np.negative),
    "Not": _unary_evaluator(np.logical_not), "Or": _binary_evaluator(np.logical_or), "ReduceMax": _reduction_evaluator(np.max),
    "ReduceMin": _reduction_evaluator(np.min), "ReduceProd": _reduction_evaluator(np.prod), "ReduceSum": _reduction_evaluator(np.sum),
    "Sub": _binary_evaluator(np.subtract), "Xor": _binary_evaluator(np.logical_xor),
}  # fmt: skip

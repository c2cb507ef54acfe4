"""Lists the ONNX operators that a GPU provider runs as a buffer copy, without a kernel.

Graph capture records only kernels, so the output of a copy keeps the values of the first run.
Measured with ONNX Runtime's WebGPU provider: views, and operators that have nothing to do.
"""

__all__ = ["VARIADIC", "VIEWS", "is_copy"]

VIEWS = frozenset({"Flatten", "Identity", "Reshape", "Squeeze", "Unsqueeze"})
"""Operators that return their first input in every case."""

VARIADIC = frozenset({"Max", "Min"})
"""Operators that do with a single input; Sum and Mean have no kernel."""


def is_copy(operator: str, inputs: int, *, keeps_all_axes: bool) -> bool:
    """Return whether an ONNX operator returns its first input bit for bit.

    Args:
        operator: Its type.
        inputs: The number of its inputs.
        keeps_all_axes: Whether a reduction keeps every axis: ``noop_with_empty_axes`` is 1, and no axes are given.
    """
    if operator in VIEWS:
        return True
    if operator.startswith("Reduce"):
        return keeps_all_axes
    return operator in VARIADIC and inputs == 1

"""Operators that a GPU provider carries out by copying a buffer, without any kernel.

Graph capture records kernels, so an output that one of them makes keeps what it held at first.
Measured with ONNX Runtime's WebGPU provider: views, and operators that have nothing to do.
"""

__all__ = ["is_copy"]

_VIEWS = frozenset({"Flatten", "Identity", "Reshape", "Squeeze", "Unsqueeze"})
_VARIADIC = frozenset(
    {"Max", "Min"}
)  # of one input they return it; Sum and Mean have no kernel


def is_copy(operator: str, inputs: int, *, keeps_all_axes: bool) -> bool:
    """Say whether an operator of the ONNX domain passes its first input on, bit for bit.

    Args:
        operator: Its type.
        inputs: How many inputs it has.
        keeps_all_axes: It reduces no axis: ``noop_with_empty_axes`` is 1, and no axes are given.
    """
    if operator in _VIEWS:
        return True
    if operator.startswith("Reduce"):
        return keeps_all_axes
    return operator in _VARIADIC and inputs == 1

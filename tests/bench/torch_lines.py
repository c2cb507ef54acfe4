"""Appends to a model the torch line that a hint gives, such as ``rows[:, :3] = rows[:, :3] / 255``.

Every name stands for the output that the finding is about. Lines are parsed, never evaluated.
"""

import ast
from collections.abc import Callable
from typing import Any

import numpy as np
import onnx

OPERATORS = {ast.Add: "Add", ast.Sub: "Sub", ast.Mult: "Mul", ast.Div: "Div"}


class LineWriter:
    """Writes the ONNX nodes of one torch line.

    Attributes:
        nodes: The nodes, in order; ``old`` is the output before, and ``new`` after the line.
        weights: Their constants by name.
    """

    def __init__(self, elem_type: int) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.weights: dict[str, np.ndarray] = {}
        self._elem_type = elem_type

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Append a node; return the name of its output."""
        name = f"mend_{len(self.nodes)}"
        self.nodes.append(onnx.helper.make_node(operator, inputs, [name], **attributes))  # noqa: TID251
        return name

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        """Store a constant; return its name."""
        name = f"mend_weight_{len(self.weights)}"
        self.weights[name] = np.array(value, dtype)
        return name

    def line(self, text: str) -> None:
        """Write the nodes of a line: an assignment to the output or its columns, or an expression."""
        [statement] = ast.parse(text).body
        old = self.add("Cast", "old", to=onnx.TensorProto.FLOAT)
        if isinstance(statement, ast.Expr):
            result = self.value(statement.value, old)
        else:
            assert isinstance(statement, ast.Assign)
            result = self.value(statement.value, old)
            if isinstance(target := statement.targets[0], ast.Subscript):
                first, end = self._columns(target)
                parts = [self._part(old, 0, first), result, self._part(old, end, 1 << 30)]
                result = self.add("Concat", *parts, axis=1)
        self.nodes.append(
            onnx.helper.make_node("Cast", [result], ["new"], to=self._elem_type)  # noqa: TID251
        )

    def value(self, node: ast.expr, old: str) -> str:
        """Write the nodes of an expression; return the name of the result."""
        if isinstance(node, ast.Constant):
            return self.constant(node.value)
        if isinstance(node, ast.Name):
            return old
        if isinstance(node, ast.BinOp):
            operands = (self.value(node.left, old), self.value(node.right, old))
            return self.add(OPERATORS[type(node.op)], *operands)
        if isinstance(node, ast.Subscript):
            return self._part(old, *self._columns(node))
        assert isinstance(node, ast.Call)
        assert isinstance(node.func, ast.Attribute)
        arguments = [self.value(argument, old) for argument in node.args]
        is_method = not (isinstance(node.func.value, ast.Name) and node.func.value.id == "torch")
        receiver = [self.value(node.func.value, old)] if is_method else []
        return FUNCTIONS[node.func.attr](self, *receiver, *arguments)

    def _part(self, name: str, first: int, end: int) -> str:
        bounds = [self.constant([bound], np.int64) for bound in (first, end, 1)]
        return self.add("Slice", name, *bounds)

    def _columns(self, node: ast.Subscript) -> tuple[int, int]:
        assert isinstance(node.slice, ast.Tuple)
        columns = node.slice.elts[1]
        assert isinstance(columns, ast.Slice)
        bounds = [ast.literal_eval(b) if b else None for b in (columns.lower, columns.upper)]
        return bounds[0] or 0, 1 << 30 if bounds[1] is None else bounds[1]


def _is_finite(writer: LineWriter, x: str) -> str:
    is_odd = writer.add("Or", writer.add("IsNaN", x), writer.add("IsInf", x))
    return writer.add("Cast", writer.add("Not", is_odd), to=onnx.TensorProto.FLOAT)


def _all(writer: LineWriter, x: str, *_: str) -> str:
    lowest = writer.add("ReduceMin", x, writer.constant([1], np.int64), keepdims=1)
    return writer.add("Cast", lowest, to=onnx.TensorProto.BOOL)


def _logit(writer: LineWriter, x: str) -> str:
    rest = writer.add("Sub", writer.constant(1.0), x)
    return writer.add("Log", writer.add("Div", x, rest))


FUNCTIONS: dict[str, Callable[..., str]] = {
    "all": _all,
    "isfinite": _is_finite,
    "logit": _logit,
    "where": lambda writer, *inputs: writer.add("Where", *inputs),
}

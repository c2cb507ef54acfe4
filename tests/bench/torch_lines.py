"""Adds to a model the torch lines that a hint gives, such as ``rows[:, :3] = rows[:, :3] / 255``.

A line that assigns to an input begins the module, one that assigns to an output ends it. Names are
those of the graph; ``rows``, ``color``, ``count`` and ``cells`` are the outputs of these roles. A
line that assigns to a new name adds an output.
Lines are interpreted, never evaluated: torch traces them, and the nodes of the trace join the graph.
"""

import ast
import io
import operator
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import onnx
import torch

OPERATORS: Mapping[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.MatMult: operator.matmul,
    ast.USub: operator.neg,
    ast.Invert: operator.invert,
    ast.BitAnd: operator.and_,
    ast.Gt: operator.gt,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.GtE: operator.ge,
}

# The operator sets that torch traces to.
OPSETS = 16, 20


class Line(torch.nn.Module):
    """A module that does what one line of torch says, to tensors of these names."""

    def __init__(self, text: str, names: list[str]) -> None:
        super().__init__()
        [statement] = ast.parse(text).body
        assert isinstance(statement, ast.Assign)
        self.statement, self.names = statement, names
        self.variables: dict[str, Any] = {}

    def forward(self, *tensors: torch.Tensor) -> torch.Tensor:
        """Return the tensor that the line assigns to, after it."""
        self.variables = {n: t.clone() for n, t in zip(self.names, tensors, strict=True)}
        result, [target] = self.value(self.statement.value), self.statement.targets
        if isinstance(target, ast.Name):
            return torch.as_tensor(result)
        assert isinstance(target, ast.Subscript)
        tensor = self.value(target.value)
        tensor[self.value(target.slice)] = result
        return torch.as_tensor(tensor)

    def value(self, node: ast.expr | None) -> Any:
        """Return the value of an expression."""
        match node:
            case None:
                return None
            case ast.Constant(value):
                return value
            case ast.Name(name):
                return torch if name == "torch" else self.variables[name]
            case ast.Attribute(owner, name):
                assert not name.startswith("_")
                return getattr(self.value(owner), name)
            case ast.BinOp(left, action, right):
                return OPERATORS[type(action)](self.value(left), self.value(right))
            case ast.UnaryOp(action, operand):
                return OPERATORS[type(action)](self.value(operand))
            case ast.Compare(left, [action], [right]):
                return OPERATORS[type(action)](self.value(left), self.value(right))
            case ast.List(elements):
                return [self.value(element) for element in elements]
            case ast.Tuple(elements):
                return tuple(self.value(element) for element in elements)
            case ast.Slice(lower, upper, step):
                return slice(self.value(lower), self.value(upper), self.value(step))
            case ast.Subscript(owner, index):
                return self.value(owner)[self.value(index)]
            case ast.Call(function, arguments, keywords):
                named = {k.arg or "": self.value(k.value) for k in keywords}
                return self.value(function)(*map(self.value, arguments), **named)
        raise NotImplementedError(ast.dump(node))


def add_line(model: onnx.ModelProto, text: str, roles: Mapping[str, str]) -> None:
    """Add a line to a model, as its first if it assigns to an input, otherwise as its last.

    Args:
        model: The model, which is changed.
        text: The line.
        roles: Names that a line uses for outputs, such as ``rows``, and their names in the graph.
    """
    graph = model.graph
    inputs = {value.name: value for value in graph.input}
    values = inputs | {value.name: value for value in graph.output}
    known = {word: name for word, name in roles.items() if word not in values and name in values}
    values |= {word: values[name] for word, name in known.items()}
    words = list(dict.fromkeys(n.id for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Name)))
    if words[0] not in values:
        values[words[0]] = graph.output.add(name=words[0])
    target = values[words[0]]
    words = [word for word in words if word != "torch" and values[word].type.ByteSize()]
    prefix = f"line_{len(graph.node)}."
    opset = next(entry.version for entry in model.opset_import if not entry.domain)
    assert opset >= OPSETS[0], "an operator set of old"
    part, result = _traced(
        text, {word: values[word] for word in words}, prefix, min(opset, OPSETS[1])
    )
    is_first = target.name in inputs
    inner = f"{prefix}{target.name}"
    if is_first:
        _rename(graph, target.name, inner, ("input",))
    else:
        _rename(graph, target.name, inner, ("input", "output"))
    names = {word: values[word].name for word in words}
    names |= {w: inner for w in words if not is_first and values[w].name == target.name}
    for node in part.graph.node:
        node.input[:] = [names.get(name, name) for name in node.input]
        node.output[:] = [
            (inner if is_first else target.name) if name == result else name for name in node.output
        ]
    nodes = [*part.graph.node, *graph.node] if is_first else [*graph.node, *part.graph.node]
    graph.node.clear()
    graph.node.extend(nodes)
    graph.initializer.extend(part.graph.initializer)
    if not is_first:
        target.type.CopyFrom(part.graph.output[0].type)


def _rename(graph: onnx.GraphProto, name: str, new_name: str, ends: tuple[str, ...]) -> None:
    for node in graph.node:
        for end in ends:
            names = getattr(node, end)
            names[:] = [new_name if entry == name else entry for entry in names]
    for weight in graph.initializer:
        weight.name = new_name if weight.name == name else weight.name


def _traced(
    text: str, values: Mapping[str, onnx.ValueInfoProto], prefix: str, opset: int
) -> tuple[onnx.ModelProto, str]:
    """Return the graph that torch makes of a line, and the name of its result."""
    examples = []
    for value in values.values():
        tensor = value.type.tensor_type
        dtype = onnx.helper.tensor_dtype_to_np_dtype(tensor.elem_type)  # noqa: TID251
        sizes = [dim.dim_value or 2 for dim in tensor.shape.dim]
        examples.append(torch.ones(sizes, dtype=getattr(torch, dtype.name)))
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            Line(text, list(values)),
            tuple(examples),
            file,
            dynamo=False,
            opset_version=opset,
            input_names=list(values),
            output_names=["result"],
        )
    part = onnx.load_model_from_string(file.getvalue())
    kept = {*values, ""}
    for node in part.graph.node:
        node.name = prefix + node.name
        for names in (node.input, node.output):
            names[:] = [name if name in kept else prefix + name for name in names]
    for weight in part.graph.initializer:
        weight.name = prefix + weight.name
    return part, prefix + "result"

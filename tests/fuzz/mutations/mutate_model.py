"""Mutations of a model: what exporters, editors and attackers could make of an ONNX graph.

Each takes a parsed model and a source of chance, and changes the model in place. What it makes need
not be valid; protobuf can hold it, that is all.
"""

__all__ = ["MUTATIONS", "Mutation"]

import random
import string
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message
from onnx import (
    AttributeProto,
    GraphProto,
    ModelProto,
    NodeProto,
    StringStringEntryProto,
    TensorProto,
    numpy_helper,
)

from gsgen.contract.model.model_file import bodies

Mutation = Callable[[ModelProto, random.Random], None]

_SIZES = (0, 1, 2, 3, 4, 7, 8, 10, 48, 255, 256, 65536, 1 << 31, 1 << 36, 1 << 62)
NUMBERS = (*_SIZES, (1 << 63) - 1, -1, -2, -10, -(1 << 31), -(1 << 63))
_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-45, 1e38, -1e38, float("inf"), float("nan"))
_SPECIAL = (*_FLOATS, float("-inf"), 0.5, 2.0, 65504.0, 65520.0, 6e-8, 3e38, 1e20, -5.0)
_UNARY = (
    *("Identity", "Sqrt", "Log", "Exp", "Neg", "Reciprocal", "Floor", "Sigmoid", "Sin", "Tan"),
    *("Abs", "Relu", "Softmax", "Acos", "Erf", "Round", "Sign", "CumSum", "Transpose"),
)
_BINARY = ("Add", "Sub", "Mul", "Div", "Pow", "Mod", "Max", "Min", "MatMul")
_BYTES = (b"", b"\0", b"\xff" * 8, b"\0\0\xc0\x7f", b"x" * 4096)
TEXTS = (
    *("", " ", "/", "..", "\n", "\t\x1b[31m", "\x7f", "a\u0301", "名前", "🙂", "\u202e"),
    *("%s%n", "{}", "${HOME}", "nan", "0", "-1", "None", "gaussians", "color", "time"),
    *("num_points", "<b>", "'\"", "a,b", "a::b", "x" * 5000, "::error::x", "\\", "|`*_"),
)
_OPERATORS = (
    *("Identity", "Reshape", "Loop", "If", "Scan", "Constant", "Expand", "Gather", "Concat"),
    *("Split", "Shape", "Cast", "Where", "Range", "Tile", "Pad", "Slice", "ConstantOfShape"),
    *("NonZero", "TopK", "ScatterND", "RandomNormal", "Einsum", "SequenceEmpty", "Optional"),
    *("StringNormalizer", "MatMul", "Conv", "Resize", "GridSample", "BatchNormalization"),
    *("Dropout", "LSTM", "Unique", "DFT", "Squeeze", "Sqrt", "Div", "Pow", "Mod", "CumSum"),
    *("QuantizeLinear", "NonMaxSuppression", "MaxUnpool", "TfIdfVectorizer", "NoSuchOperator"),
)
_DOMAINS = ("", "ai.onnx", "ai.onnx.ml", "com.microsoft", "acme", "AI.ONNX", "\u200b")
_OPSETS = (0, -1, 1, 6, 7, 9, 12, 13, 17, 21, 22, 23, 24, 25, 99, 1 << 31, (1 << 63) - 1)
_LOCATIONS = (
    *("", ".", "..", "../a.bin", "/etc/hostname", "/dev/zero", "/proc/self/mem", "a\0b"),
    *("C:\\a", "\\\\host\\a", "weights.bin", "colors.bin", "table.bin", "a/../../b"),
    *("x" * 300, "🙂.bin", "%2e%2e/a", "file:///etc/hostname", "./colors.bin", "nul"),
)
_LENGTHS = ("", "0", "1", "-1", "60", "1e3", "0x10", "٣", "²", "9" * 30, "9" * 5000, "60 ")


def _messages(message: Message) -> Iterator[Message]:
    """Yield ``message`` and every message inside, to any depth."""
    queue = [message]
    while queue:
        node = queue.pop()
        yield node
        for field, value in node.ListFields():
            if field.type == FieldDescriptor.TYPE_MESSAGE:
                queue.extend(value if field.is_repeated else [value])


def _random_message(model: ModelProto, rng: random.Random) -> Message:
    """Choose a kind of message first, so that rare kinds have their turn, too."""
    kinds: dict[str, list[Message]] = {}
    for message in _messages(model):
        kinds.setdefault(message.DESCRIPTOR.name, []).append(message)
    return rng.choice(kinds[rng.choice(sorted(kinds))])


def _value(field: FieldDescriptor, rng: random.Random) -> Any:
    """Return a value that fits the type of a scalar field, and little else."""
    kind = field.cpp_type
    if kind in (FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_DOUBLE):
        return rng.choice(_FLOATS)
    if kind == FieldDescriptor.CPPTYPE_ENUM:
        return rng.choice([*(value.number for value in field.enum_type.values), 77, -5])
    if kind == FieldDescriptor.CPPTYPE_STRING:
        return rng.choice(TEXTS if field.type == FieldDescriptor.TYPE_STRING else _BYTES)
    number = rng.choice(NUMBERS)
    if kind == FieldDescriptor.CPPTYPE_INT32:
        return max(-(1 << 31), min(number, (1 << 31) - 1))
    return number % (1 << 64) if kind == FieldDescriptor.CPPTYPE_UINT64 else number


def set_a_field(model: ModelProto, rng: random.Random) -> None:
    """Give a field of any message any value of its type."""
    message = _random_message(model, rng)
    field = rng.choice(message.DESCRIPTOR.fields)
    if field.type == FieldDescriptor.TYPE_MESSAGE:
        if field.is_repeated:
            getattr(message, field.name).add()
        else:
            getattr(message, field.name).SetInParent()
    elif field.is_repeated:
        values = getattr(message, field.name)
        if values and rng.random() < 0.7:
            values[rng.randrange(len(values))] = _value(field, rng)
        else:
            values.append(_value(field, rng))
    else:
        setattr(message, field.name, _value(field, rng))


def clear_a_field(model: ModelProto, rng: random.Random) -> None:
    """Take a field away that is set."""
    message = _random_message(model, rng)
    fields = message.ListFields()
    if fields:
        message.ClearField(rng.choice(fields)[0].name)


def shuffle_a_list(model: ModelProto, rng: random.Random) -> None:
    """Drop, repeat or move an entry of a repeated field."""
    message = _random_message(model, rng)
    lists = [value for field, value in message.ListFields() if field.is_repeated]
    if not lists:
        return
    values = rng.choice(lists)
    entries = [_copied(entry) for entry in values]
    offset = rng.randrange(len(entries))
    how = rng.choice(("drop", "repeat", "move", "many"))
    if how in ("drop", "move"):
        entry = entries.pop(offset)
        if how == "move":
            entries.insert(rng.randint(0, len(entries)), entry)
    else:
        entries[offset:offset] = [entries[offset]] * (1 if how == "repeat" else 40)
    del values[:]
    values.extend(entries)


def _copied(entry: Any) -> Any:
    if not isinstance(entry, Message):
        return entry
    copy = type(entry)()
    copy.CopyFrom(entry)
    return copy


def graft(model: ModelProto, rng: random.Random) -> None:
    """Put a copy of one message in the place of another of its kind."""
    first = _random_message(model, rng)
    same = [message for message in _messages(model) if message.DESCRIPTOR is first.DESCRIPTOR]
    second = _copied(rng.choice(same))
    first.CopyFrom(second)


def _values(model: ModelProto) -> list[Any]:
    graph = model.graph
    return [*graph.input, *graph.output, *graph.value_info]


def resize(model: ModelProto, rng: random.Random) -> None:
    """Change a size of an input, an output, a value or a weight."""
    dims = [d for value in _values(model) for d in value.type.tensor_type.shape.dim]
    weights = [weight for weight in model.graph.initializer if weight.dims]
    if weights and (not dims or rng.random() < 0.4):
        weight = rng.choice(weights)
        weight.dims[rng.randrange(len(weight.dims))] = rng.choice(NUMBERS)
    elif dims:
        dim = rng.choice(dims)
        if rng.random() < 0.3:
            dim.dim_param = rng.choice(("N", "", *TEXTS))
        else:
            dim.dim_value = rng.choice(NUMBERS)


def rerank(model: ModelProto, rng: random.Random) -> None:
    """Add or drop an axis, or the whole shape."""
    values = _values(model)
    if not values:
        return
    kind = rng.choice(values).type.tensor_type
    how = rng.randrange(4)
    if how == 0:
        kind.ClearField("shape")
    elif how == 1:
        kind.shape.SetInParent()
        del kind.shape.dim[:]
    elif how == 2 and kind.shape.dim:
        del kind.shape.dim[rng.randrange(len(kind.shape.dim))]
    else:
        for _ in range(rng.choice((1, 2, 70))):
            kind.shape.dim.add(dim_value=rng.choice(_SIZES))


def retype(model: ModelProto, rng: random.Random) -> None:
    """Change a dtype, or make a tensor a sequence, a map or an optional."""
    code = rng.choice([*TensorProto.DataType.values(), 99, -1])
    weights = list(model.graph.initializer)
    if weights and rng.random() < 0.4:
        rng.choice(weights).data_type = code
        return
    values = _values(model)
    if values:
        kind = rng.choice(values).type
        other = rng.choice(("tensor_type",) * 4 + ("sequence_type", "optional_type"))
        inner = kind if other == "tensor_type" else getattr(kind, other).elem_type
        inner.tensor_type.elem_type = code


def rename(model: ModelProto, rng: random.Random) -> None:
    """Give an input, output, weight or node the name of another, none, or a strange one."""
    graph = model.graph
    named = [*_values(model), *graph.initializer, *graph.node]
    if named:
        used_names = [entry.name for entry in named]
        rng.choice(named).name = rng.choice(used_names if rng.random() < 0.5 else TEXTS)


def rewire(model: ModelProto, rng: random.Random) -> None:
    """Let a node read or write another tensor: cycles, gaps, two writers."""
    nodes = [node for body in bodies(model) for node in body.node]
    if not nodes:
        return
    node = rng.choice(nodes)
    known = [name for node in nodes for name in (*node.input, *node.output)]
    name = rng.choice(known) if known and rng.random() < 0.7 else rng.choice(TEXTS)
    ends = rng.choice((node.input, node.output))
    if ends and rng.random() < 0.8:
        ends[rng.randrange(len(ends))] = name
    else:
        ends.append(name)


def reoperate(model: ModelProto, rng: random.Random) -> None:
    """Let a node be another operator, or of another domain."""
    nodes = [node for body in bodies(model) for node in body.node]
    if nodes:
        node = rng.choice(nodes)
        if rng.random() < 0.8:
            node.op_type = rng.choice(_OPERATORS)
        else:
            node.domain = rng.choice(_DOMAINS)


def starve(model: ModelProto, rng: random.Random) -> None:
    """Store more, less or other payload than a weight's shape asks for."""
    tensors = [message for message in _messages(model) if isinstance(message, TensorProto)]
    if not tensors:
        return
    tensor = rng.choice(tensors)
    raw = tensor.raw_data
    how = rng.randrange(6)
    if how == 0:
        tensor.raw_data = raw[: rng.randint(0, len(raw))]
    elif how == 1:
        tensor.raw_data = raw + b"\0" * rng.choice((1, 3, 4, 1 << 16))
    elif how == 2:
        tensor.ClearField("raw_data")
    elif how == 3:
        field = rng.choice(("float_data", "int32_data", "int64_data", "double_data"))
        getattr(tensor, field).extend([1] * rng.choice((1, 5, 100)))
    elif how == 4:
        tensor.string_data.extend([b"a", b"\xff"])
    elif raw:
        offset = rng.randrange(len(raw))
        tensor.raw_data = (
            raw[:offset] + rng.randbytes(min(4, len(raw) - offset)) + raw[offset + 4 :]
        )


def unsettle(model: ModelProto, rng: random.Random) -> None:
    """Put strange numbers into a weight; its size stays right, so that the model runs."""
    floats = (TensorProto.FLOAT, TensorProto.FLOAT16, TensorProto.DOUBLE)
    weights = [
        weight
        for weight in model.graph.initializer
        if weight.data_type in floats
        and weight.raw_data
        and weight.data_location != TensorProto.EXTERNAL
    ]
    if not weights:
        return
    weight = rng.choice(weights)
    array = numpy_helper.to_array(weight).copy()
    flat = array.reshape(-1)
    with np.errstate(all="ignore"):
        if rng.random() < 0.3:
            flat *= np.array(rng.choice(_SPECIAL), array.dtype)
        elif flat.size:
            places = [rng.randrange(flat.size) for _ in range(rng.choice((1, 3, 50)))]
            flat[places] = np.array(rng.choice(_SPECIAL)).astype(array.dtype)
    weight.CopyFrom(numpy_helper.from_array(array, weight.name))


def swap_operator(model: ModelProto, rng: random.Random) -> None:
    """Let a node compute something else from the same inputs, so that shapes stay right."""
    swaps = [
        (node, pool)
        for node in model.graph.node
        for pool in (_UNARY, _BINARY)
        if node.op_type in pool
    ]
    if swaps:
        node, pool = rng.choice(swaps)
        node.op_type = rng.choice(pool)


def swap_inputs(model: ModelProto, rng: random.Random) -> None:
    """Let a node take its inputs in another order, or one of them twice."""
    nodes = [node for node in model.graph.node if len(node.input) > 1]
    if nodes:
        node = rng.choice(nodes)
        names = list(node.input)
        if rng.random() < 0.5:
            rng.shuffle(names)
        else:
            names[rng.randrange(len(names))] = rng.choice(names)
        del node.input[:]
        node.input.extend(names)


def externalise(model: ModelProto, rng: random.Random) -> None:
    """Say that a weight lies in another file, at any place and of any length."""
    tensors = [message for message in _messages(model) if isinstance(message, TensorProto)]
    if not tensors:
        return
    tensor = rng.choice(tensors)
    tensor.data_location = TensorProto.EXTERNAL
    if rng.random() < 0.8:
        tensor.ClearField("raw_data")
    for key, values in (("location", _LOCATIONS), ("offset", _LENGTHS), ("length", _LENGTHS)):
        for _ in range(rng.choice((0, 1, 1, 1, 2))):
            tensor.external_data.add(key=key, value=rng.choice(values))


def reimport(model: ModelProto, rng: random.Random) -> None:
    """Change what the model says of IR and operator sets."""
    how = rng.randrange(4)
    if how == 0:
        model.ir_version = rng.choice(_OPSETS)
    elif how == 1:
        del model.opset_import[:]
    elif how == 2 or not model.opset_import:
        model.opset_import.add(domain=rng.choice(_DOMAINS), version=rng.choice(_OPSETS))
    else:
        rng.choice(model.opset_import).version = rng.choice(_OPSETS)


def nest(model: ModelProto, rng: random.Random) -> None:
    """Put the graph, or a part, into branches of itself, shallow or deep."""
    graph = GraphProto()
    graph.CopyFrom(model.graph)
    del graph.input[:]
    if rng.random() < 0.5:
        graph.ClearField("initializer")
    depth = rng.choice((1, 1, 1, 2, 5, 24, 60, 90))
    if depth > 2:
        del graph.node[2:]
        graph.ClearField("initializer")
    for _ in range(depth):
        outer_graph = GraphProto(name="outer", output=model.graph.output)
        node = outer_graph.node.add(op_type=rng.choice(("If", "Loop", "Scan", "Acme")))
        node.input.extend([rng.choice(("", "time", "live", "c"))])
        node.output.extend(value.name for value in graph.output)
        for name in rng.choice((("then_branch", "else_branch"), ("body",))):
            node.attribute.add(name=name, type=AttributeProto.GRAPH, g=graph)
            if depth > 5:
                break
        graph = outer_graph
    model.graph.node.extend(graph.node)


def functionise(model: ModelProto, rng: random.Random) -> None:
    """Define a function: of the graph's nodes, of itself, under the name of an operator."""
    function = model.functions.add(
        name=rng.choice(("F", "Add", "Identity", *TEXTS)), domain=rng.choice(_DOMAINS)
    )
    if rng.random() < 0.8:
        function.opset_import.add(domain="", version=rng.choice(_OPSETS))
    function.input.extend(value.name for value in model.graph.input)
    function.output.extend(value.name for value in model.graph.output)
    if rng.random() < 0.7:
        function.node.extend(model.graph.node)
    call = NodeProto(op_type=function.name, domain=function.domain)
    call.input.extend(function.input)
    call.output.extend(function.output)
    if rng.random() < 0.4:
        function.node.append(call)
    if rng.random() < 0.7:
        del model.graph.node[:]
        model.graph.node.append(call)


def decorate(model: ModelProto, rng: random.Random) -> None:
    """Add an attribute, metadata or a training graph that nobody expects."""
    how = rng.randrange(4)
    nodes = list(model.graph.node)
    if how == 0 and nodes:
        kinds = AttributeProto.AttributeType.values()
        first = rng.choice(nodes).attribute.add(
            name=rng.choice(("axis", "to", "value", "body", "perm", "shape", *TEXTS)),
            type=rng.choice(kinds),
        )
        first.i, first.f = rng.choice(NUMBERS), rng.choice(_FLOATS)
        first.ints.extend(rng.choices(NUMBERS, k=rng.choice((0, 1, 3))))
    elif how == 1:
        key = rng.choice(("gsgen.manifest", "gsgen.contract", *TEXTS))
        entry = StringStringEntryProto(key=key, value=rng.choice(TEXTS))
        model.metadata_props.insert(rng.randint(0, len(model.metadata_props)), entry)
    elif how == 2:
        model.training_info.add().algorithm.CopyFrom(model.graph)
    else:
        sparse = model.graph.sparse_initializer.add(dims=[rng.choice(NUMBERS)])
        names = [weight.name for weight in model.graph.initializer]
        sparse.values.name = rng.choice([*names, "", "sparse"])
        sparse.values.data_type = rng.choice(TensorProto.DataType.values())


def lengthen(model: ModelProto, rng: random.Random) -> None:
    """Hang a long chain of nodes on a tensor."""
    graph = model.graph
    if not graph.node or not graph.node[0].output:
        return
    last = graph.node[0].output[0]
    for index in range(rng.choice((50, 300, 1500))):
        name = f"{last[:20]}_{index}_{''.join(rng.choices(string.ascii_lowercase, k=3))}"
        graph.node.add(op_type="Identity", input=[last], output=[name])
        last = name


MUTATIONS: tuple[Mutation, ...] = (
    *(set_a_field, set_a_field, clear_a_field, shuffle_a_list, graft, resize, resize),
    *(rerank, retype, retype, rename, rename, rewire, reoperate, starve, externalise),
    *(reimport, nest, functionise, decorate, lengthen),
    *(unsettle, unsettle, unsettle, swap_operator, swap_operator, swap_inputs),
)

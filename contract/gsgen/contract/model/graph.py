"""The graph of an ONNX model for static rules: tensors with shapes, producers, consumers."""

__all__ = [
    "Conflict",
    "Graph",
    "Tensor",
    "read_graph",
    "static_dims",
    "stored_bytes",
    "tensor_bytes",
]

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import onnx
from onnx import (
    AttributeProto,
    FunctionProto,
    GraphProto,
    ModelProto,
    NodeProto,
    SparseTensorProto,
    TensorProto,
    ValueInfoProto,
)

from gsgen.contract.model.model_file import STUB_BYTES, ModelFile, bodies, subgraphs
from gsgen.contract.model.shape_inference import first_line, infer, propagate

Dims = tuple[int | str | None, ...]

_MAX_DEPTH = 64
_SPECIAL_DTYPE_NAMES = {"FLOAT": "float32", "DOUBLE": "float64", "UNDEFINED": None}
_DTYPE_NAMES = {
    code: _SPECIAL_DTYPE_NAMES.get(name, name.lower())
    for name, code in TensorProto.DataType.items()
}


@dataclass(frozen=True, slots=True)
class Tensor:
    """Name, dtype and dimensions of an ONNX tensor, as far as they are known statically.

    Attributes:
        name: Its name in the graph.
        dtype: ``float32``, ``int64``, …; None if unknown.
        dims: A size, a symbol or None (unknown) for each axis; None where even the rank is unknown.
    """

    name: str
    dtype: str | None
    dims: Dims | None

    def __str__(self) -> str:
        dims = (
            "?" if self.dims is None else ", ".join("?" if d is None else str(d) for d in self.dims)
        )
        return f"{self.dtype or '?'} [{dims}]"


@dataclass(frozen=True, slots=True)
class Conflict:
    """A tensor whose declared type contradicts the type that ONNX shape inference found."""

    name: str
    declared: Tensor
    inferred: Tensor


@dataclass(slots=True)
class _GraphFacts:
    """Results of ``onnx.checker`` and ONNX shape inference, collected while a model is read."""

    tensors: dict[str, Tensor]
    conflicts: tuple[Conflict, ...] = ()
    checker: str = ""
    inference: str = ""


@dataclass(frozen=True, kw_only=True)
class Graph:
    """The main graph of a model, with inferred tensor shapes, for static rules.

    Attributes:
        inputs: The inputs that a runtime feeds, in order, without listed initialisers.
        outputs: Declared outputs, in order, with inferred sizes where the model leaves them open.
        nodes: Every node of the main graph.
        initializers: Names of the weights.
        conflicts: Tensors whose declared and inferred types contradict each other.
        checker_fault: The complaint of ``onnx.checker``; empty if it passes.
        inference_fault: The complaint of shape inference; empty if it passes.
        output_names: Names of the outputs, in order.
        declared_outputs: The outputs as the file declares them, without inferred ones.
    """

    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    nodes: tuple[NodeProto, ...]
    initializers: dict[str, Tensor]
    tensors: dict[str, Tensor]
    functions: frozenset[tuple[str, str]]
    conflicts: tuple[Conflict, ...] = ()
    checker_fault: str = ""
    inference_fault: str = ""
    output_names: tuple[str, ...] = field(default=())
    declared_outputs: tuple[Tensor, ...] = field(default=())

    @cached_property
    def producers(self) -> dict[str, NodeProto]:
        """Map each tensor name to the main-graph node that produces the tensor."""
        return {name: node for node in self.nodes for name in node.output if name}

    @cached_property
    def use_counts(self) -> dict[str, int]:
        """Map each tensor name to the number of main-graph nodes and outputs that read it."""
        count: dict[str, int] = {}
        for names in self._names_read_by_node.values():
            for name in names:
                count[name] = count.get(name, 0) + 1
        for output in self.outputs:
            count[output.name] = count.get(output.name, 0) + 1
        return count

    @cached_property
    def _names_read_by_node(self) -> dict[int, list[str]]:
        """Map the ``id`` of each node to the names of the tensors that the node reads."""
        return {id(node): names_read(node) for node in self.nodes}

    def output(self, name: str) -> Tensor | None:
        """Return the graph output called ``name``, or None."""
        return next((tensor for tensor in self.outputs if tensor.name == name), None)

    def input(self, name: str) -> Tensor | None:
        """Return the graph input called ``name``, or None."""
        return next((tensor for tensor in self.inputs if tensor.name == name), None)

    def ancestors(self, name: str) -> tuple[set[str], list[NodeProto]]:
        """Return the names of all tensors that a tensor is computed from, and the nodes involved.

        The result is cached: do not modify it.
        """
        if name not in self._ancestors_by_name:
            self._ancestors_by_name[name] = self._trace_ancestors(name)
        return self._ancestors_by_name[name]

    @cached_property
    def _ancestors_by_name(self) -> dict[str, tuple[set[str], list[NodeProto]]]:
        return {}

    def _trace_ancestors(self, name: str) -> tuple[set[str], list[NodeProto]]:
        names, nodes, queue = {name}, [], [name]
        visited_keys: set[int] = set()
        while queue:
            node = self.producers.get(queue.pop())
            key = id(node)
            if node is None or key in visited_keys:
                continue
            visited_keys.add(key)
            nodes.append(node)
            for name in self._names_read_by_node[key]:
                if name not in names:
                    names.add(name)
                    queue.append(name)
        return names, nodes

    def varies(self, name: str) -> bool:
        """Return whether the tensor ``name`` depends on a model input that is fed every frame."""
        names, _ = self.ancestors(name)
        return any(tensor.name in names for tensor in self.inputs)

    def all_nodes(self) -> Iterator[NodeProto]:
        """Yield every node of the model, including the bodies of If, Loop and Scan nodes."""
        return iter(self._all_nodes)

    @cached_property
    def _all_nodes(self) -> list[NodeProto]:
        return [nested_node for node in self.nodes for nested_node in _nested_nodes(node, 0)]


def names_read(node: NodeProto) -> list[str]:
    """Return the tensor names that ``node`` reads, including reads inside its subgraphs."""
    names = list(filter(None, node.input))
    for attribute in node.attribute:
        for graph in subgraphs(attribute):
            for nested_node in graph.node:
                names.extend(names_read(nested_node))
            names.extend(output.name for output in graph.output)
    return names


def read_graph(file: ModelFile) -> Graph:
    """Read a model's main graph: infer shapes, check well-formedness, record contradictions.

    Weights are not needed: a tensor without its payload becomes an input of the copy that
    ONNX's own library checks.
    """
    graph = file.proto.graph
    facts = _infer_facts(file)
    weights = {tensor.name: _weight_tensor(tensor) for tensor in graph.initializer}
    weights |= {
        s.values.name: _weight_tensor(_densify_sparse_tensor(s)) for s in graph.sparse_initializer
    }
    inputs = tuple(_value_tensor(v) for v in graph.input if v.name not in weights)
    outputs = tuple(
        _merge_declared(_value_tensor(v), facts.tensors.get(v.name)) for v in graph.output
    )
    return Graph(
        inputs=inputs,
        outputs=outputs,
        nodes=tuple(graph.node),
        initializers=weights,
        tensors=facts.tensors | weights | {t.name: t for t in (*inputs, *outputs)},
        functions=frozenset((f.domain, f.name) for f in file.proto.functions),
        conflicts=facts.conflicts,
        checker_fault=facts.checker,
        inference_fault=facts.inference,
        output_names=tuple(v.name for v in graph.output),
        declared_outputs=tuple(map(_value_tensor, graph.output)),
    )


def _infer_facts(file: ModelFile) -> _GraphFacts:
    proto = _proto_without_stub_tensors(file)
    facts = _GraphFacts({})
    try:
        onnx.checker.check_model(proto)
    except (onnx.checker.ValidationError, ValueError, RuntimeError) as error:
        facts.checker = first_line(error)
        return facts  # inference on a malformed graph repeats the same complaint
    declared = {v.name: _value_tensor(v) for v in (*proto.graph.output, *proto.graph.value_info)}
    for value in proto.graph.output:
        value.ClearField("type")
    del proto.graph.value_info[:]
    inferred, facts.inference = infer(proto)
    if inferred is None:
        return facts
    tensors = _value_infos(inferred)
    if not facts.inference and _has_missing_producers(proto, tensors):
        inferred, facts.inference = propagate(proto, inferred)
        tensors = _value_infos(inferred)
    facts.tensors = {
        name: _merge_declared(declared.get(name), tensor) for name, tensor in tensors.items()
    }
    facts.conflicts = tuple(
        Conflict(name, tensor, tensors[name])
        for name, tensor in declared.items()
        if name in tensors and not _is_compatible(tensor, tensors[name])
    )
    return facts


def _value_infos(proto: ModelProto) -> dict[str, Tensor]:
    return {v.name: _value_tensor(v) for v in (*proto.graph.value_info, *proto.graph.output)}


def _has_missing_producers(proto: ModelProto, tensors: dict[str, Tensor]) -> bool:
    """Return whether shape inference left the shape of some node output unknown."""
    sizes = (tensor.dims for tensor in tensors.values())
    if any(dims is None or any(type(d) is not int for d in dims) for dims in sizes):
        return True
    outputs = (name for node in proto.graph.node for name in node.output)
    return any(name and name not in tensors for name in outputs)


def _proto_without_stub_tensors(file: ModelFile) -> ModelProto:
    """Return a copy of a model without unread weights, which ONNX's checker accepts.

    Weights of the main graph become inputs of the same type. Weights of subgraphs become
    sparse constants without entries, which have a type and a shape but no payload.
    """
    copy = ModelProto()
    copy.CopyFrom(file.proto)
    copy.ClearField("metadata_props")
    if file.whole:
        return copy
    graph_inputs = {value.name for value in copy.graph.input}
    for tensor in _remove_stubs(copy.graph):
        if tensor.name not in graph_inputs:
            _add_input(copy.graph, tensor)
    for body in bodies(copy):
        if isinstance(body, GraphProto):
            for tensor in _remove_stubs(body):
                body.node.insert(0, _constant_node(tensor))
        _fill_nodes(body)
    return copy


def _is_stub_tensor(tensor: TensorProto) -> bool:
    return tensor.raw_data == STUB_BYTES


def _remove_stubs(graph: GraphProto) -> list[TensorProto]:
    """Remove and return a graph's weights whose data were not read from the file.

    Sparse weights too: a runtime makes them dense, but shape inference ignores that.
    """
    weights = list(graph.initializer)
    stub_weights = [tensor for tensor in weights if _is_stub_tensor(tensor)]
    if stub_weights:
        del graph.initializer[:]
        graph.initializer.extend(tensor for tensor in weights if not _is_stub_tensor(tensor))
    stub_weights += [_densify_sparse_tensor(sparse) for sparse in graph.sparse_initializer]
    del graph.sparse_initializer[:]
    return stub_weights


def _densify_sparse_tensor(sparse: SparseTensorProto) -> TensorProto:
    kind = sparse.values.data_type
    return TensorProto(
        name=sparse.values.name, data_type=kind, dims=sparse.dims, raw_data=STUB_BYTES
    )


def _add_input(graph: GraphProto, tensor: TensorProto) -> None:
    value = graph.input.add(name=tensor.name)
    value.type.tensor_type.elem_type = tensor.data_type
    value.type.tensor_type.shape.SetInParent()
    for dim in tensor.dims:
        value.type.tensor_type.shape.dim.add(dim_value=dim)


def _constant_node(tensor: TensorProto) -> NodeProto:
    value = AttributeProto(name="value", type=AttributeProto.TENSOR, t=tensor)
    return NodeProto(op_type="Constant", output=[tensor.name], attribute=[value])


def _fill_nodes(body: GraphProto | FunctionProto) -> None:
    """Put valid empty tensors in place of node attributes' tensors whose data were not read."""
    for index in reversed(range(len(body.node))):
        node = body.node[index]
        for attribute in node.attribute:
            for tensor in (attribute.t, *attribute.tensors):
                if _is_stub_tensor(tensor) and node.op_type == "Constant" and 0 not in tensor.dims:
                    if not tensor.dims:  # a sparse tensor needs an axis, which a scalar lacks
                        body.node.insert(index + 1, _squeeze_node(node))
                    _make_sparse(attribute, tensor)
                elif _is_stub_tensor(tensor):
                    tensor.CopyFrom(_empty_tensor(tensor.data_type))
            for sparse in (attribute.sparse_tensor, *attribute.sparse_tensors):
                _clear_sparse(sparse)


def _squeeze_node(node: NodeProto) -> NodeProto:
    """Make a scalar output a vector of length 1; return a Squeeze that restores the scalar."""
    name = node.output[0]
    node.output[0] = f"{name}/stub"
    return NodeProto(op_type="Squeeze", input=node.output, output=[name])


def _make_sparse(attribute: AttributeProto, tensor: TensorProto) -> None:
    sparse = SparseTensorProto(dims=tensor.dims or [1], values=_empty_tensor(tensor.data_type))
    sparse.indices.CopyFrom(_empty_tensor(TensorProto.INT64))
    kind = AttributeProto.SPARSE_TENSOR
    sparse_value = AttributeProto(name="sparse_value", type=kind, sparse_tensor=sparse)
    attribute.CopyFrom(sparse_value)


def _clear_sparse(sparse: SparseTensorProto) -> None:
    if _is_stub_tensor(sparse.values) or _is_stub_tensor(sparse.indices):
        sparse.values.CopyFrom(_empty_tensor(sparse.values.data_type))
        sparse.indices.CopyFrom(_empty_tensor(TensorProto.INT64))


def _empty_tensor(dtype: int) -> TensorProto:
    return TensorProto(data_type=dtype, dims=[0])


def _nested_nodes(node: NodeProto, depth: int) -> Iterator[NodeProto]:
    yield node
    if depth < _MAX_DEPTH:
        for attribute in node.attribute:
            for graph in subgraphs(attribute):
                for nested_node in graph.node:
                    yield from _nested_nodes(nested_node, depth + 1)


def _weight_tensor(tensor: TensorProto) -> Tensor:
    return Tensor(tensor.name, _DTYPE_NAMES.get(tensor.data_type), tuple(tensor.dims))


def _value_tensor(value: ValueInfoProto) -> Tensor:
    kind = value.type.tensor_type
    if not value.type.HasField("tensor_type"):
        return Tensor(value.name, None, None)
    dims: Dims | None = None
    if kind.HasField("shape"):
        dims = tuple(
            d.dim_value if d.HasField("dim_value") else (d.dim_param or None)
            for d in kind.shape.dim
        )
    return Tensor(value.name, _DTYPE_NAMES.get(kind.elem_type), dims)


def _merge_declared(declared: Tensor | None, inferred: Tensor | None) -> Tensor:
    """Merge a tensor's declared type with its inferred type; fixed sizes win over symbols."""
    if declared is None or inferred is None:
        known = declared or inferred
        assert known is not None
        return known
    dims = declared.dims
    if dims is None:
        dims = inferred.dims
    elif inferred.dims is not None and len(inferred.dims) == len(dims):
        pairs = zip(dims, inferred.dims, strict=True)
        dims = tuple(
            a if isinstance(a, int) else b if isinstance(b, int) else a or b for a, b in pairs
        )
    return Tensor(declared.name, declared.dtype or inferred.dtype, dims)


def _is_compatible(declared: Tensor, inferred: Tensor) -> bool:
    if declared.dtype and inferred.dtype and declared.dtype != inferred.dtype:
        return False
    if declared.dims is None or inferred.dims is None:
        return True
    if len(declared.dims) != len(inferred.dims):
        return False
    pairs = zip(declared.dims, inferred.dims, strict=True)
    return all(a == b or not (isinstance(a, int) and isinstance(b, int)) for a, b in pairs)


def tensor_bytes(tensor: Tensor) -> int:
    """Return the size of ``tensor`` in bytes; 0 if unknown."""
    dims = static_dims(tensor)
    if dims is None:
        return 0
    bits = _DTYPE_BITS.get(tensor.dtype or "", 32)
    for dim in dims:
        bits *= int(dim)
    return -(-bits // 8)


def stored_bytes(weight: TensorProto) -> int:
    """Return the bytes that the shape and dtype of a weight need; 0 if unknown."""
    return tensor_bytes(_weight_tensor(weight))


def static_dims(tensor: Tensor) -> tuple[int, ...] | None:
    """Return the dimensions of ``tensor`` if all of them are positive numbers, else None."""
    if tensor.dims is None:
        return None
    sizes = [dim for dim in tensor.dims if isinstance(dim, int) and dim > 0]
    return tuple(sizes) if len(sizes) == len(tensor.dims) else None


# Bits of an element of each dtype that does not have 32.
_DTYPE_BITS = {
    "complex128": 128,
    "complex64": 64,
    "float64": 64,
    "int64": 64,
    "uint64": 64,
    "float16": 16,
    "bfloat16": 16,
    "int16": 16,
    "uint16": 16,
    "int8": 8,
    "uint8": 8,
    "bool": 8,
    "float8e4m3fn": 8,
    "float8e4m3fnuz": 8,
    "float8e5m2": 8,
    "float8e5m2fnuz": 8,
    "float8e8m0": 8,
    "float6e2m3": 6,
    "float6e3m2": 6,
    "float4e2m1": 4,
    "int4": 4,
    "uint4": 4,
    "int2": 2,
    "uint2": 2,
}

"""Builds ONNX graphs from protobuf messages, node by node."""

__all__ = ["GraphBuilder"]

from collections.abc import Sequence

import numpy as np
from onnx import AttributeProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, numpy_helper

_DTYPES = {
    "float32": TensorProto.FLOAT,
    "float16": TensorProto.FLOAT16,
    "float64": TensorProto.DOUBLE,
    "bfloat16": TensorProto.BFLOAT16,
    "int32": TensorProto.INT32,
    "int64": TensorProto.INT64,
    "uint8": TensorProto.UINT8,
    "int8": TensorProto.INT8,
    "bool": TensorProto.BOOL,
}

Dim = int | str


class GraphBuilder:
    """A graph under construction; values are handled by their names."""

    def __init__(self, *, opset: int = 18, ir_version: int = 9) -> None:
        self.proto = ModelProto(ir_version=ir_version, producer_name="hand-written")
        self.proto.graph.name = "generator"
        self.import_domain("", opset)
        self._names = 0

    def import_domain(self, domain: str, version: int) -> None:
        """Import an operator set."""
        self.proto.opset_import.add(domain=domain, version=version)

    def constant(self, value: object, dtype: str = "float32", name: str = "") -> str:
        """Add an initialiser and return its name."""
        array = np.asarray(value).astype(dtype)
        name = name or self._name("weight")
        self.proto.graph.initializer.append(numpy_helper.from_array(array, name))
        return name

    def input(self, name: str, shape: Sequence[Dim], dtype: str = "float32") -> str:
        """Add a graph input and return its name."""
        self.proto.graph.input.append(value_info(name, shape, dtype))
        return name

    def output(
        self, name: str, source: str, shape: Sequence[Dim] | None, dtype: str = "float32"
    ) -> None:
        """Make the value ``source`` a graph output called ``name``.

        The node that computes it gives the output itself, as exporters write it; a weight or a
        graph input goes through an Identity.
        """
        if not self._rename(source, name):
            self.node("Identity", [source], [name])
        self.proto.graph.output.append(value_info(name, shape, dtype))

    def op(self, kind: str, *inputs: str, domain: str = "", **attributes: object) -> str:
        """Add a node with one output and return the output's name."""
        name = self._name(kind.lower())
        self.node(kind, inputs, [name], domain=domain, **attributes)
        return name

    def node(
        self,
        kind: str,
        inputs: Sequence[str],
        outputs: Sequence[str],
        domain: str = "",
        **attributes: object,
    ) -> NodeProto:
        """Add a node."""
        node = self.proto.graph.node.add(op_type=kind, input=inputs, output=outputs, domain=domain)
        node.name = f"{kind}_{len(self.proto.graph.node)}"
        for key, value in attributes.items():
            node.attribute.append(attribute(key, value))
        return node

    def cast(self, source: str, dtype: str) -> str:
        """Add a Cast."""
        return self.op("Cast", source, to=int(_DTYPES[dtype]))

    def gather(self, source: str, index: object, axis: int) -> str:
        """Add a Gather at constant indices."""
        return self.op("Gather", source, self.constant(index, "int64"), axis=axis)

    def reshape(self, source: str, *shape: int) -> str:
        """Add a Reshape to a constant shape."""
        return self.op("Reshape", source, self.constant(shape, "int64"))

    def _rename(self, source: str, name: str) -> bool:
        """Rename what a node gives; return False where no node gives it."""
        nodes = self.proto.graph.node
        if not any(source in node.output for node in nodes):
            return False
        for node in nodes:
            node.output[:] = [name if value == source else value for value in node.output]
            node.input[:] = [name if value == source else value for value in node.input]
        return True

    def _name(self, stem: str) -> str:
        self._names += 1
        return f"{stem}_{self._names}"


def value_info(name: str, shape: Sequence[Dim] | None, dtype: str) -> ValueInfoProto:
    """Describe a tensor; ``None`` leaves its shape open, a word names a symbolic size."""
    info = ValueInfoProto(name=name)
    info.type.tensor_type.elem_type = _DTYPES[dtype]
    if shape is not None:
        info.type.tensor_type.shape.SetInParent()
        for size in shape:
            dim = info.type.tensor_type.shape.dim.add()
            if isinstance(size, str):
                dim.dim_param = size
            else:
                dim.dim_value = size
    return info


def attribute(name: str, value: object) -> AttributeProto:
    """Make an attribute from a Python number, word, list, array or graph.

    Raises:
        TypeError: The value has none of these types.
    """
    proto = AttributeProto(name=name)
    if isinstance(value, bool | int):
        proto.type, proto.i = AttributeProto.INT, int(value)
    elif isinstance(value, float):
        proto.type, proto.f = AttributeProto.FLOAT, value
    elif isinstance(value, str):
        proto.type, proto.s = AttributeProto.STRING, value.encode()
    elif isinstance(value, list):
        proto.type = AttributeProto.INTS
        proto.ints.extend(value)
    elif isinstance(value, np.ndarray):
        proto.type = AttributeProto.TENSOR
        proto.t.CopyFrom(numpy_helper.from_array(value))
    elif type(value).__name__ == "GraphProto":
        proto.type = AttributeProto.GRAPH
        proto.g.CopyFrom(value)
    else:
        raise TypeError(f"attribute {name} cannot hold a {type(value).__name__}")
    return proto

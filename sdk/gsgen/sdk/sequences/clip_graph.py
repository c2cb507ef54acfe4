"""Writes a clip as an ONNX graph with the input ``time``, which decodes one moment.

Weights of the knots are hat functions of the time; their product with the coefficients of a table
weighs its bytes. Bytes stay bytes in memory: ONNX Runtime folds constant nodes at loading, but
``DequantizeLinear`` it leaves to run, and with it all that depends on it. Where a target computes that
wrongly, tables are float16, which holds the numbers of bytes exactly.
"""

__all__ = ["clip_model"]

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import onnx_ir as ir

from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.manifest_io import dumps
from gsgen.sdk.exporting.embed_manifest import with_profile
from gsgen.sdk.passes.framework.graph_builder import new_node, weight
from gsgen.sdk.sequences.clip import DIGIT_ZERO, SIZE_STEP, Clip, Palette, RowGroup, Table

_IR_VERSION: Final = 8
# Bytes of one dequantised part of a table: small parts stay in the cache of a core.
_PART_BYTES: Final = 8 << 20
_MAX_CONCAT_INPUTS: Final = 4
_LABEL_BASE: Final = 256


class _GraphWriter:
    """Adds nodes and weights to a graph.

    Args:
        time: The input for the time.
        opset: The ONNX operator set.
        has_bytes: Whether tables are bytes, instead of float16.
    """

    def __init__(self, time: ir.Value, opset: int, *, has_bytes: bool) -> None:
        self._has_bytes = has_bytes
        self.graph = ir.Graph([time], [], nodes=[], opset_imports={"": opset}, name="clip")
        self._shared: dict[tuple[float | int, ...], ir.Value] = {}
        self._count = 0

    def weight(self, array: np.ndarray, name: str = "") -> ir.Value:
        """Add a weight, under a name if readers of clips look for it."""
        return weight(self.graph, name or f"weight_{len(self.graph.initializers)}", array)

    def scalar(self, value: float) -> ir.Value:
        """Return a float32 constant, which nodes share."""
        key = (float(value),)
        if key not in self._shared:
            self._shared[key] = self.weight(np.array(value, np.float32))
        return self._shared[key]

    def sizes(self, *values: int) -> ir.Value:
        """Return an int64 list, which nodes share."""
        key = (len(values), *values)
        if key not in self._shared:
            self._shared[key] = self.weight(np.array(values, np.int64))
        return self._shared[key]

    def op(self, op_type: str, *inputs: ir.Value, **attributes: Any) -> ir.Value:
        """Add a node, and return its output."""
        self._count += 1
        node = new_node(op_type, inputs, f"{op_type}_{self._count}", **attributes)
        self.graph.append(node)
        return node.outputs[0]

    def rows(self, values: ir.Value, start: int, stop: int, axis: int = 0) -> ir.Value:
        """Return a part of a tensor along an axis."""
        return self.op("Slice", values, self.sizes(start), self.sizes(stop), self.sizes(axis))

    def join(self, parts: Sequence[ir.Value], axis: int) -> ir.Value:
        """Join at most four tensors, as many as a node may have inputs in every runtime."""
        return parts[0] if len(parts) == 1 else self.op("Concat", *parts, axis=axis)

    def digits(self, values: np.ndarray, scale: float, name: str) -> ir.Value:
        """Return bytes as float32, less 128, times a scale."""
        if not self._has_bytes:
            numbers = self.weight(values.astype(np.float16) - np.float16(DIGIT_ZERO), name)
            numbers = self.op("Cast", numbers, to=ir.DataType.FLOAT.value)
            return numbers if scale == 1 else self.op("Mul", numbers, self.scalar(scale))
        if () not in self._shared:
            self._shared[()] = self.weight(np.array(DIGIT_ZERO, np.uint8))
        return self.op(
            "DequantizeLinear", self.weight(values, name), self.scalar(scale), self._shared[()]
        )

    def add_output(self, value: ir.Value, name: str, dtype: ir.DataType, *shape: int) -> None:
        """Make a value an output of the graph."""
        value.name, value.type, value.shape = name, ir.TensorType(dtype), ir.Shape(shape)
        self.graph.outputs.append(value)


def clip_model(
    clip: Clip, manifest: GeneratorManifest, opset: int, *, has_bytes: bool = True
) -> ir.Model:
    """Return the ONNX model of a clip; the manifest names its input and its outputs.

    Without ``has_bytes``, tables are float16.
    """
    declared = manifest.outputs
    assert declared.gaussians is not None
    assert declared.appearance is not None
    assert declared.count is not None
    name = manifest.inputs[0].name
    time = ir.Value(name=name, type=ir.TensorType(ir.DataType.FLOAT), shape=ir.Shape([1]))
    graph = _GraphWriter(time, opset, has_bytes=has_bytes)
    knots = _knot_weights(graph, time, clip)
    rows = [_group_rows(graph, group, knots, f"group{i}") for i, group in enumerate(clip.groups)]
    graph.add_output(
        graph.join(rows, 0),
        declared.gaussians.name,
        ir.DataType.FLOAT,
        len(clip),
        layout.ROW_LENGTH,
    )
    color = graph.join(
        [
            _planes_to_rows(graph, _table(graph, group.color, knots, f"group{i}.color"))
            for i, group in enumerate(clip.groups)
        ],
        0,
    )
    if clip.space == "rgb":
        color = graph.op("Clip", color, graph.scalar(0.0), graph.scalar(1.0))
    if clip.palette is not None:
        color = graph.join([color, _palette_rows(graph, clip.palette)], 1)
    graph.add_output(color, declared.appearance.name, ir.DataType.FLOAT, len(clip), clip.channels)
    count = graph.weight(np.array([len(clip)], np.int32))
    count = graph.op("Mul", count, graph.weight(np.array(1, np.int32)))
    graph.add_output(count, declared.count.name, ir.DataType.INT32, 1)
    model = ir.Model(graph.graph, ir_version=_IR_VERSION, producer_name="gsgen")
    model.metadata_props[MANIFEST_KEY] = dumps(with_profile(manifest, model), indent=None)
    return model


def _knot_weights(graph: _GraphWriter, time: ir.Value, clip: Clip) -> ir.Value:
    """Return the weights [1, K] of the knots: hat functions of the time."""
    place = graph.op("Mul", time, graph.scalar(clip.frames))
    place = graph.op("Clip", place, graph.scalar(0.0), graph.scalar(clip.knots - 1))
    knots = graph.weight(np.arange(clip.knots, dtype=np.float32)[None])
    distance = graph.op("Abs", graph.op("Sub", place, knots))
    return graph.op("Relu", graph.op("Sub", graph.scalar(1.0), distance))


def _table(graph: _GraphWriter, table: Table, knots: ir.Value | None, name: str) -> ir.Value:
    """Return the values [planes, n] of a table."""
    coefficients = graph.weight(table.coefficients, f"{name}.coefficients")
    if len(table.coefficients) > 1:
        assert knots is not None
        coefficients = graph.op("MatMul", knots, coefficients)
    count, width = table.digits.shape
    step = max(1, _PART_BYTES // (4 * width))
    total: ir.Value | None = None
    # Part by part, so that the dequantised bytes need little memory.
    for start in range(0, count, step):
        stop = min(start + step, count)
        weights = (
            coefficients if stop - start == count else graph.rows(coefficients, start, stop, 1)
        )
        part = graph.op(
            "MatMul", weights, graph.digits(table.digits[start:stop], 1.0, f"{name}.digits.{start}")
        )
        total = graph.op("Add", total, part) if total is not None else part
    assert total is not None
    return graph.op("Reshape", total, graph.sizes(table.planes, -1))


def _planes_to_rows(graph: _GraphWriter, planes: ir.Value) -> ir.Value:
    return graph.op("Transpose", planes, perm=[1, 0])


def _group_rows(graph: _GraphWriter, group: RowGroup, knots: ir.Value, name: str) -> ir.Value:
    """Return the packed rows [n, 10] of a group."""
    # Sizes are exponentials of bytes.
    exponent = graph.digits(group.size[None], SIZE_STEP, f"{name}.size")
    size = graph.op(
        "Mul",
        graph.op("Exp", exponent),
        graph.weight(np.array(group.size_unit, np.float32), f"{name}.size_unit"),
    )
    position = _table(graph, group.place, knots, f"{name}.place")
    if group.motion is not None:
        motion = graph.op("Mul", _table(graph, group.motion, knots, f"{name}.motion"), size)
        position = graph.op("Add", position, motion)
    opacity = graph.op(
        "Add", _table(graph, group.opacity, knots, f"{name}.opacity"), graph.scalar(0.5)
    )
    opacity = graph.op("Clip", opacity, graph.scalar(0.0), graph.scalar(1.0))
    factors = graph.op("Mul", _table(graph, group.factors, knots, f"{name}.factors"), size)
    # Σ = L Lᵀ, where a column of L below its diagonal gives a part of a row of Σ.
    first, second = graph.rows(factors, 0, 3), graph.rows(factors, 3, 5)
    l00, l10, l20 = (graph.rows(factors, index, index + 1) for index in range(3))
    l11, l21, l22 = (graph.rows(factors, index, index + 1) for index in range(3, 6))
    xx_xy_xz = graph.op("Mul", l00, first)
    yy_yz = graph.op(
        "Add", graph.op("Mul", l10, graph.rows(factors, 1, 3)), graph.op("Mul", l11, second)
    )
    squares = [graph.op("Mul", factor, factor) for factor in (l20, l21, l22)]
    zz = graph.op("Add", graph.op("Add", *squares[:2]), squares[2])
    covariance = graph.join([xx_xy_xz, yy_yz, zz], 0)
    return _planes_to_rows(graph, graph.join([position, opacity, covariance], 0))


def _palette_rows(graph: _GraphWriter, palette: Palette) -> ir.Value:
    """Return the SH coefficients [n, k] of all rows but for the constant term."""
    high, low = np.divmod(palette.labels, _LABEL_BASE)
    # Bytes are stored about 128, so 128 · 257 is added again.
    label = graph.op(
        "Mul",
        graph.digits(high.astype(np.uint8), 1.0, "palette.labels_high"),
        graph.scalar(_LABEL_BASE),
    )
    label = graph.op("Add", label, graph.digits(low.astype(np.uint8), 1.0, "palette.labels_low"))
    label = graph.op("Add", label, graph.scalar(DIGIT_ZERO * (_LABEL_BASE + 1)))
    entries = _planes_to_rows(graph, _table(graph, palette.entries, None, "palette.entries"))
    return graph.op("Gather", entries, graph.op("Cast", label, to=ir.DataType.INT32.value), axis=0)

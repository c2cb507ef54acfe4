"""A model that rounds selected nodes and weights to float16, selectable for each run."""

__all__ = ["FLAGS_INPUT", "GUARD_ELEMENTS", "InstrumentedModel", "tables"]

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx_ir as ir
from jaxtyping import Bool

from gsgen.contract.model.load_failures import explain_load_failure
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.spec.units import FLOAT16_MAX, FLOAT16_SMALLEST_NORMAL
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.float16.to_float16 import (
    FLOAT,
    FLOAT16,
    can_compute_in_float16,
    convertible_indices,
    node_key,
)
from gsgen.sdk.float16.weight_tables import HalfTable, half_table
from gsgen.sdk.passes.framework.base import is_op, opset_of
from gsgen.sdk.passes.framework.graph_builder import new_node, weight
from gsgen.sdk.passes.framework.value_facts import required
from gsgen.sdk.rewriting.constant_subgraph import partition_constants
from gsgen.sdk.rewriting.model_io import save_model

FLAGS_INPUT = "computed_in_float16"
# A constant with more elements is a table: an element that becomes zero does not guard a division.
GUARD_ELEMENTS = 16
# Operators that only move numbers: a GPU flushes subnormal numbers where it computes with them.
_MOVE_OPERATORS = (
    *("Cast", "Concat", "Expand", "Flatten", "Gather", "Identity", "Reshape", "Slice", "Split"),
    *("Squeeze", "Transpose", "Unsqueeze", "Where"),
)


class InstrumentedModel:
    """Runs a model with selected nodes rounded to float16, in one session for every selection.

    A selected node reads float32 numbers that were rounded to float16, and its result is rounded,
    too. A device exceeds this error only if it also adds up in float16. Numbers beyond 65,504
    become infinite. Numbers below 2⁻¹⁴ become zero where a node computes with them, since a GPU may
    flush them.

    Nodes that depend on weights alone are computed once, in float32, and cannot be selected. Any
    table of weights can be stored in 16 bits a number.

    Args:
        model: The model in float32.
        weights_only: No node can be selected. The session then lacks the nodes that round, which
            cost most of its time and memory.

    Attributes:
        units: Name of each node that can be selected, in the order of the graph.
        weights: Name of each table that can be stored in 16 bits a number
            (:func:`gsgen.sdk.float16.weight_tables.half_table`).
        sizes: Count of numbers in each table.
        unstepped: Indices of the tables that are stored as float16, also where even steps are closer.
    """

    def __init__(self, model: ir.Model, *, weights_only: bool = False) -> None:
        part = partition_constants(model)
        copy = part.per_frame
        opset = opset_of(copy)
        candidate_nodes = () if weights_only else copy.graph
        nodes = [node for node in candidate_nodes if can_compute_in_float16(node, opset)]
        self.units = tuple(node_key(node) for node in nodes)
        self._tables = {table.name or "": _array(table) for table in tables(model.graph)}
        self._stored_tables: dict[str, HalfTable] = {}
        self.unstepped: frozenset[int] = frozenset()
        self.weights = tuple(self._tables)
        self.sizes = tuple(array.size for array in self._tables.values())
        self._names = [value.name or "" for value in copy.graph.outputs]
        self._boundary_names, self._cached_constants = (
            list(part.boundary),
            _CachedConstants(b"", {}),
        )
        _add_table_inputs(copy, self.weights)
        _instrument_model(copy, nodes, opset)
        self._session, self._constant_session = _session(copy, rounds=bool(nodes)), None
        if part.constant is not None:
            _add_table_inputs(part.constant, self.weights)
            self._constant_session = _session(part.constant, rounds=False)

    def run(
        self,
        inputs: Mapping[str, np.ndarray],
        selected: Bool[np.ndarray, " n"],
        stored: Bool[np.ndarray, " w"] | None = None,
    ) -> dict[str, np.ndarray]:
        """Return the float32 outputs with the selected nodes and weights rounded to float16."""
        if stored is None:
            stored = np.zeros(len(self.weights), np.bool_)
        session_inputs = {**inputs, **self._constants(stored), FLAGS_INPUT: selected}
        return _run(self._session, self._names, session_inputs)

    def _stored_table(self, name: str) -> HalfTable:
        """Return a weight table rounded to its 16-bit storage."""
        if name not in self._stored_tables:
            rounds_in_steps = self.weights.index(name) not in self.unstepped
            self._stored_tables[name] = half_table(
                self._tables[name], rounds_in_steps=rounds_in_steps
            )
        return self._stored_tables[name]

    def is_evenly_quantized(self, table: int) -> bool:
        """Return whether a weight table is quantised evenly in 16 bits rather than as float16."""
        return self._stored_table(self.weights[table]).step is not None

    def store_unstepped(self, tables: Collection[int]) -> None:
        """Allow only float16, not evenly spaced 16-bit values, for the listed weight tables."""
        for table in self.unstepped ^ frozenset(tables):
            self._stored_tables.pop(self.weights[table], None)
        self.unstepped, self._cached_constants = frozenset(tables), _CachedConstants(b"", {})

    def _constants(self, stored: Bool[np.ndarray, " w"]) -> Mapping[str, np.ndarray]:
        """Return weights, some rounded to 16 bits, and results of nodes that use only weights."""
        key = stored.tobytes()
        if key != self._cached_constants.key or not self._cached_constants.arrays:
            arrays = {
                name: self._stored_table(name).decoded if half else array
                for (name, array), half in zip(self._tables.items(), stored, strict=True)
            }
            if self._constant_session is not None:
                arrays |= _run(self._constant_session, self._boundary_names, arrays)
            self._cached_constants = _CachedConstants(key, arrays)
        return self._cached_constants.arrays


@dataclass(frozen=True, slots=True)
class _CachedConstants:
    """Cached results of constant nodes, valid for one set of weights stored in 16 bits."""

    key: bytes
    arrays: Mapping[str, np.ndarray]


def tables(graph: ir.Graph) -> list[ir.Value]:
    """Return the large float32 weights of a model whose values fit the range of float16."""
    return [value for value in graph.initializers.values() if _is_lookup_table(value)]


def _is_lookup_table(value: ir.Value) -> bool:
    if value.dtype != FLOAT or value.const_value is None or value.is_graph_input():
        return False
    if value.const_value.size <= GUARD_ELEMENTS:
        return False
    return bool(np.abs(_array(value)).max(initial=0) <= FLOAT16_MAX)


def _array(value: ir.Value) -> np.ndarray:
    assert value.const_value is not None
    return np.asarray(value.const_value.numpy())


def _run(session: Any, names: list[str], arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    input_names = {tensor.name for tensor in session.get_inputs()}
    inputs = {name: value for name, value in arrays.items() if name in input_names}
    outputs: Sequence[np.ndarray] = session.run(names, inputs)
    return dict(zip(names, outputs, strict=True))


def _add_table_inputs(model: ir.Model, names: Sequence[str]) -> None:
    """Turn weight tables into graph inputs, so that each run can feed rounded tables."""
    for name in names:
        value = model.graph.initializers.pop(name, None)
        if value is not None:
            value.const_value = None
            model.graph.inputs.append(value)


def _session(model: ir.Model, *, rounds: bool) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    # An arena keeps the memory of the largest frame between the runs.
    options.enable_cpu_mem_arena = False
    if rounds:  # optimisation would remove the pairs of Casts
        level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.graph_optimization_level = level
    with temporary_folder() as folder:
        file = folder / "measured.onnx"
        save_model(model, file)
        try:
            return onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # ONNX Runtime's errors share no base class of their own
            failure = explain_load_failure(str(error))
            message = f"ONNX Runtime does not load the model: {failure.cause}"
            raise RewriteFailed(message, where="float16", hint=failure.hint) from error


def _instrument_model(model: ir.Model, nodes: Sequence[ir.Node], opset: int) -> None:
    graph = model.graph
    if not nodes:
        return
    flags = ir.Value(
        name=FLAGS_INPUT, type=ir.TensorType(ir.DataType.BOOL), shape=ir.Shape([len(nodes)])
    )
    graph.inputs.append(flags)
    zero = weight(graph, "float16_zero", np.zeros((), np.float32))
    smallest_normal = weight(graph, "float16_tiny", np.asarray(FLOAT16_SMALLEST_NORMAL, np.float32))
    for number, node in enumerate(nodes):
        inputs, outputs = convertible_indices(node, opset)
        unit = weight(graph, f"float16_unit_{number}", np.asarray(number))
        flag = new_node(
            "Gather", [flags, unit], f"float16_flag_{number}", dtype=ir.DataType.BOOL, axis=0
        )
        graph.insert_before(node, flag)
        for index in inputs:
            value = required(node.inputs[index])
            before = _rounding_nodes(value, f"float16_in_{number}_{index}")
            if not is_op(node, *_MOVE_OPERATORS):
                before += _flush_to_zero_nodes(before[-1].outputs[0], smallest_normal, zero)
            before.append(_select_node(flag, before[-1].outputs[0], value))
            graph.insert_before(node, before)
            node.replace_input_with(index, before[-1].outputs[0])
        for index in outputs:
            _round_output(graph, node, index, flag, number)


def _round_output(graph: ir.Graph, node: ir.Node, index: int, flag: ir.Node, number: int) -> None:
    value = node.outputs[index]
    name, readers = value.name, list(value.uses())
    value.name = f"float16_raw_{number}_{index}"
    rounding_nodes = _rounding_nodes(value, f"float16_out_{number}_{index}")
    rounding_nodes.append(_select_node(flag, rounding_nodes[-1].outputs[0], value))
    result = rounding_nodes[-1].outputs[0]
    result.name, result.shape = name, value.shape
    graph.insert_after(node, rounding_nodes)
    for use in readers:
        use.node.replace_input_with(use.idx, result)
    for position, output in enumerate(graph.outputs):
        if output is value:
            graph.outputs[position] = result


def _rounding_nodes(value: ir.Value, name: str) -> list[ir.Node]:
    half = new_node("Cast", [value], f"{name}_half", dtype=FLOAT16, to=FLOAT16.value)
    float32_cast = new_node("Cast", [half.outputs[0]], f"{name}_back", dtype=FLOAT, to=FLOAT.value)
    return [half, float32_cast]


def _flush_to_zero_nodes(
    value: ir.Value, smallest_normal: ir.Value, zero: ir.Value
) -> list[ir.Node]:
    size = new_node("Abs", [value], f"{value.name}_size", dtype=FLOAT)
    is_small = new_node(
        "Less", [size.outputs[0], smallest_normal], f"{value.name}_small", dtype=ir.DataType.BOOL
    )
    result = new_node(
        "Where", [is_small.outputs[0], zero, value], f"{value.name}_flushed", dtype=FLOAT
    )
    return [size, is_small, result]


def _select_node(flag: ir.Node, rounded: ir.Value, value: ir.Value) -> ir.Node:
    return new_node(
        "Where", [flag.outputs[0], rounded, value], f"{rounded.name}_chosen", dtype=FLOAT
    )

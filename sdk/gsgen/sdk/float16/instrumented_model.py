"""A model that can compute any of its nodes as if in float16, chosen anew at every run."""

__all__ = ["FLAGS", "GUARD_ELEMENTS", "LARGEST", "HalfModel", "tables"]

import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx_ir as ir
from jaxtyping import Bool

from gsgen.sdk.float16.to_float16 import FLOAT, HALF, halves, key_of, places_of
from gsgen.sdk.float16.weight_tables import HalfTable, half_table
from gsgen.sdk.passes.framework.base import is_op, opset_of
from gsgen.sdk.passes.framework.graph_builder import new_node, weight
from gsgen.sdk.rewriting.constant_subgraph import partition_constants
from gsgen.sdk.rewriting.model_io import save_model

FLAGS = "computed_in_float16"
# A constant of more elements is a table, where an element that becomes zero is no guard.
GUARD_ELEMENTS = 16
LARGEST = 65504.0
_NORMAL = np.float32(2.0**-14)
# These hand numbers on as they are, so what a GPU does to subnormal ones does not matter yet.
_MOVES = (
    *(
        "Cast",
        "Concat",
        "Expand",
        "Flatten",
        "Gather",
        "Identity",
        "Reshape",
        "Slice",
        "Split",
    ),
    *("Squeeze", "Transpose", "Unsqueeze", "Where"),
)


class HalfModel:
    """Runs a model with some nodes rounded as float16 rounds; one session serves every choice.

    A chosen node reads float32 numbers that were rounded to float16, and its result is rounded,
    too: an error that a device may go beyond only where it also adds up in float16. What is beyond
    65,504 is infinite. Where a node computes with a number below 2⁻¹⁴, that is zero, since a GPU may
    flush it.

    What follows from weights alone is computed once, in float32, wherever the rest runs; its nodes
    cannot be chosen. But any table of weights can be stored in 16 bits a number, whatever reads it.

    Attributes:
        units: Name of each node that can be chosen, in the order of the graph.
        weights: Name of each table that can be stored in 16 bits a number
            (:func:`gsgen.sdk.float16.weight_tables.half_table`).
        sizes: Numbers in each of them.
        plain: Which of them are stored as float16 even where steps are closer.
    """

    def __init__(self, model: ir.Model) -> None:
        part = partition_constants(model)
        copy = part.rest
        opset = opset_of(copy)
        nodes = [node for node in copy.graph if halves(node, opset)]
        self.units = tuple(key_of(node) for node in nodes)
        self._tables = {one.name or "": _array(one) for one in tables(model.graph)}
        self._halves: dict[str, HalfTable] = {}
        self.plain: frozenset[int] = frozenset()
        self.weights = tuple(self._tables)
        self.sizes = tuple(array.size for array in self._tables.values())
        self._names = [value.name or "" for value in copy.graph.outputs]
        self._between, self._remembered = list(part.between), _Remembered(b"", {})
        _feed_tables(copy, self.weights)
        _instrument(copy, nodes, opset)
        self._session, self._once = _session(copy), None
        if part.once is not None:
            _feed_tables(part.once, self.weights)
            self._once = _session(part.once)

    def run(
        self,
        inputs: Mapping[str, np.ndarray],
        chosen: Bool[np.ndarray, " n"],
        stored: Bool[np.ndarray, " w"] | None = None,
    ) -> dict[str, np.ndarray]:
        """Return the outputs, in float32, with the ``chosen`` units and ``stored`` tables rounded."""
        if stored is None:
            stored = np.zeros(len(self.weights), np.bool_)
        fed = {**inputs, **self._constants(stored), FLAGS: chosen}
        return _run(self._session, self._names, fed)

    def _halved(self, name: str) -> HalfTable:
        """Return a table as 16 bits a number hold it."""
        if name not in self._halves:
            in_steps = self.weights.index(name) not in self.plain
            self._halves[name] = half_table(self._tables[name], in_steps=in_steps)
        return self._halves[name]

    def is_in_steps(self, table: int) -> bool:
        """Say whether a table is stored in steps, and not as float16."""
        return self._halved(self.weights[table]).step is not None

    def store_plainly(self, tables: Collection[int]) -> None:
        """Store these tables as float16, and the others in whichever form is closer."""
        for table in self.plain ^ frozenset(tables):
            self._halves.pop(self.weights[table], None)
        self.plain, self._remembered = frozenset(tables), _Remembered(b"", {})

    def _constants(self, stored: Bool[np.ndarray, " w"]) -> Mapping[str, np.ndarray]:
        """Return tables and what follows from them; those of the last choice are remembered."""
        key = stored.tobytes()
        if key != self._remembered.key or not self._remembered.arrays:
            made = {
                name: self._halved(name).decoded if half else array
                for (name, array), half in zip(self._tables.items(), stored, strict=True)
            }
            if self._once is not None:
                made |= _run(self._once, self._between, made)
            self._remembered = _Remembered(key, made)
        return self._remembered.arrays


@dataclass(frozen=True, slots=True)
class _Remembered:
    """Tables and what follows from them, of one choice."""

    key: bytes
    arrays: Mapping[str, np.ndarray]


def tables(graph: ir.Graph) -> list[ir.Value]:
    """Return the float32 weights that are no guards, and fit float16's range."""
    return [value for value in graph.initializers.values() if _is_table(value)]


def _is_table(value: ir.Value) -> bool:
    if value.dtype != FLOAT or value.const_value is None or value.is_graph_input():
        return False
    if value.const_value.size <= GUARD_ELEMENTS:
        return False
    return bool(np.abs(_array(value)).max(initial=0) <= LARGEST)


def _array(value: ir.Value) -> np.ndarray:
    assert value.const_value is not None
    return np.asarray(value.const_value.numpy())


def _run(
    session: Any, names: list[str], given: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    taken = {one.name for one in session.get_inputs()}
    fed = {name: value for name, value in given.items() if name in taken}
    made: Sequence[np.ndarray] = session.run(names, fed)
    return dict(zip(names, made, strict=True))


def _feed_tables(model: ir.Model, names: Sequence[str]) -> None:
    """Make inputs of tables, so that a run can have them rounded."""
    for name in names:
        value = model.graph.initializers.pop(name, None)
        if value is not None:
            value.const_value = None
            model.graph.inputs.append(value)


def _session(model: ir.Model) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    # Optimisation would take the pairs of Casts away that do the rounding.
    level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.graph_optimization_level = level
    with tempfile.TemporaryDirectory(prefix="gsgen-") as folder:
        file = Path(folder) / "measured.onnx"
        save_model(model, file)
        return onnxruntime.InferenceSession(
            file, options, providers=["CPUExecutionProvider"]
        )


def _instrument(model: ir.Model, nodes: Sequence[ir.Node], opset: int) -> None:
    graph = model.graph
    if not nodes:
        return
    flags = ir.Value(
        name=FLAGS, type=ir.TensorType(ir.DataType.BOOL), shape=ir.Shape([len(nodes)])
    )
    graph.inputs.append(flags)
    zero = weight(graph, "float16_zero", np.zeros((), np.float32))
    tiny = weight(graph, "float16_tiny", np.asarray(_NORMAL))
    for number, node in enumerate(nodes):
        inputs, outputs = places_of(node, opset)
        place = weight(graph, f"float16_unit_{number}", np.asarray(number))
        flag = new_node(
            "Gather",
            [flags, place],
            f"float16_flag_{number}",
            dtype=ir.DataType.BOOL,
            axis=0,
        )
        graph.insert_before(node, flag)
        for index in inputs:
            value = node.inputs[index]
            assert value is not None
            before = _rounded(value, f"float16_in_{number}_{index}")
            if not is_op(node, *_MOVES):
                before += _flushed(before[-1].outputs[0], tiny, zero)
            before.append(_chosen(flag, before[-1].outputs[0], value))
            graph.insert_before(node, before)
            node.replace_input_with(index, before[-1].outputs[0])
        for index in outputs:
            _round_output(graph, node, index, flag, number)


def _round_output(
    graph: ir.Graph, node: ir.Node, index: int, flag: ir.Node, number: int
) -> None:
    value = node.outputs[index]
    name, readers = value.name, list(value.uses())
    value.name = f"float16_raw_{number}_{index}"
    behind = _rounded(value, f"float16_out_{number}_{index}")
    behind.append(_chosen(flag, behind[-1].outputs[0], value))
    made = behind[-1].outputs[0]
    made.name, made.shape = name, value.shape
    graph.insert_after(node, behind)
    for use in readers:
        use.node.replace_input_with(use.idx, made)
    for place, output in enumerate(graph.outputs):
        if output is value:
            graph.outputs[place] = made


def _rounded(value: ir.Value, name: str) -> list[ir.Node]:
    half = new_node("Cast", [value], f"{name}_half", dtype=HALF, to=HALF.value)
    back = new_node("Cast", [half.outputs[0]], f"{name}_back", dtype=FLOAT, to=FLOAT.value)
    return [half, back]


def _flushed(value: ir.Value, tiny: ir.Value, zero: ir.Value) -> list[ir.Node]:
    size = new_node("Abs", [value], f"{value.name}_size", dtype=FLOAT)
    small = new_node(
        "Less", [size.outputs[0], tiny], f"{value.name}_small", dtype=ir.DataType.BOOL
    )
    kept = new_node(
        "Where", [small.outputs[0], zero, value], f"{value.name}_flushed", dtype=FLOAT
    )
    return [size, small, kept]


def _chosen(flag: ir.Node, rounded: ir.Value, value: ir.Value) -> ir.Node:
    return new_node(
        "Where", [flag.outputs[0], rounded, value], f"{rounded.name}_chosen", dtype=FLOAT
    )

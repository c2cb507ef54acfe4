"""Converts a post-process model to float16, except for nodes whose rounding is visible.

WebGPU adds up in the dtype of its operands: a convolution of a few hundred float16 numbers is off
by several times the rounding of float16, and a deep network amplifies that. So operators that add
many numbers stay float32; a search measures which of the other nodes can be rounded. Weights and
both images, which are stored and transferred, become float16 wherever possible.
"""

__all__ = ["Float16ImageResult", "image_to_float16"]

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import onnx_ir as ir

from gsgen.contract.probing.probes import Probe
from gsgen.sdk.float16.instrumented_model import InstrumentedModel
from gsgen.sdk.float16.sensitivity_search import max_quantizable
from gsgen.sdk.float16.to_float16 import FLOAT, FLOAT16, ToFloat16, can_compute_in_float16, node_key
from gsgen.sdk.passes.framework.base import is_op, opset_of
from gsgen.sdk.passes.framework.graph_builder import unused_name
from gsgen.sdk.rewriting.constant_subgraph import constant_nodes
from gsgen.sdk.rewriting.rewrite import normalize_model, remove_unused

# Operators that add too many numbers for float16.
_SUMMING_OPERATORS = (
    *("Conv", "ConvTranspose", "MatMul", "Gemm", "Einsum", "Softmax", "LpNormalization"),
    *("InstanceNormalization", "LayerNormalization", "BatchNormalization", "CumSum"),
    *("ReduceSum", "ReduceMean", "ReduceL2", "ReduceSumSquare", "GlobalAveragePool"),
)
# Tolerance of computing in float16, as a share of the largest value: a quarter of the difference
# that rule GB011 allows between two devices.
_COMPUTE_TOLERANCE = 5e-4
# Tolerance of storing weights in float16, as a share of the tolerance of the whole model.
_WEIGHT_ERROR_SHARE = 0.5
_MAX_MEASUREMENTS = 24


@dataclass(frozen=True, slots=True)
class Float16ImageResult:
    """Counts of the nodes and weights of a post-process model that became float16."""

    computed: int  # number of nodes that compute in float16
    retained: int  # number of nodes that could, but compute in float32
    stored: int  # number of weights that are stored in float16
    retained_weights: tuple[str, ...]  # names of the weights that are stored in float32


def image_to_float16(
    model: ir.Model,
    image: str,
    probes: Sequence[Probe],
    allowed: float,
    progress: Callable[[str], None],
) -> Float16ImageResult:
    """Convert a post-process model to float16 in place.

    ``image`` names the input that becomes float16. ``probes`` have images that float16 can hold;
    ``allowed`` is a share of the result's largest value.
    """
    normalize_model(model)
    measure = _ImageErrorMeasure(model, probes)
    opset, constant_node_set = opset_of(model), set(constant_nodes(model.graph))
    nodes = [
        n for n in model.graph if n not in constant_node_set and can_compute_in_float16(n, opset)
    ]
    progress(f"measuring which of {len(measure.weights)} weights may be float16")
    tables = max_quantizable(
        range(len(measure.weights)),
        measure.weights_error,
        budget=_MAX_MEASUREMENTS,
        allowed=_WEIGHT_ERROR_SHARE * allowed,
    )
    measure.stored = tables.quantized
    measure.update_reference()
    progress(f"measuring which of {len(nodes)} nodes may round to float16")
    searchable_nodes = [k for k, node in enumerate(nodes) if not is_op(node, *_SUMMING_OPERATORS)]
    search_result = max_quantizable(
        searchable_nodes, measure.nodes_error, budget=_MAX_MEASUREMENTS, allowed=_COMPUTE_TOLERANCE
    )
    computed = {node_key(nodes[k]) for k in search_result.quantized}
    retained_keys = {node_key(node) for node in nodes} - computed
    stored = {measure.weights[k] for k in tables.quantized}
    _cast_input_to_float16(model.graph, image)
    ToFloat16(retained_keys, outputs=True, stored=stored)(model)
    remove_unused(model)
    retained_weights = tuple(name for name in measure.weights if name not in stored)
    return Float16ImageResult(len(computed), len(retained_keys), len(stored), retained_weights)


class _ImageErrorMeasure:
    """Measures how much rounding to float16 changes the image of a post-process model."""

    def __init__(self, model: ir.Model, probes: Sequence[Probe]) -> None:
        self._model, self._probes = InstrumentedModel(model), probes
        self.weights, self.stored = self._model.weights, frozenset[int]()
        self.update_reference()

    def update_reference(self) -> None:
        """Recompute the reference images with the weights that are already stored as float16."""
        self._expected = [self._output_image(probe, (), self.stored) for probe in self._probes]

    def weights_error(self, stored: Collection[int]) -> tuple[float, str]:
        """Return the largest relative image error of storing the given weights as float16."""
        largest_value = max(float(np.abs(image).max()) for image in self._expected)
        return self._error((), stored, largest_value), "image"

    def nodes_error(self, selected: Collection[int]) -> tuple[float, str]:
        """Return the largest relative image error of computing given nodes in float16."""
        return self._error(selected, self.stored), "image"

    def _error(
        self, selected: Collection[int], stored: Collection[int], largest_value: float = 0.0
    ) -> float:
        worst_error = 0.0
        for probe, expected in zip(self._probes, self._expected, strict=True):
            error = np.abs(self._output_image(probe, selected, stored) - expected).max()
            error = error / max(largest_value or float(np.abs(expected).max()), 1e-6)
            worst_error = max(worst_error, float(error) if error <= np.inf else np.inf)
        return worst_error

    def _output_image(
        self, probe: Probe, selected: Collection[int], stored: Collection[int]
    ) -> np.ndarray:
        flags = np.zeros(len(self._model.units), np.bool_)
        tables = np.zeros(len(self.weights), np.bool_)
        flags[list(selected)], tables[list(stored)] = True, True
        inputs = {
            name: value.astype(np.float32) if value.dtype == np.float16 else value
            for name, value in probe.inputs.items()
        }
        (image,) = self._model.run(inputs, flags, tables).values()
        return image.astype(np.float64)


def _cast_input_to_float16(graph: ir.Graph, name: str) -> None:
    """Make a graph input float16, and cast it to float32 for the nodes that read it."""
    value = next(graph_input for graph_input in graph.inputs if graph_input.name == name)
    node = ir.node("Cast", [value], attributes={"to": FLOAT.value})
    cast_output = node.outputs[0]
    cast_output.name = node.name = unused_name(graph, f"{name}_as_float32")
    cast_output.type, cast_output.shape = ir.TensorType(FLOAT), value.shape
    readers = list(value.uses())
    for use in readers:
        if use.node is not node:
            use.node.replace_input_with(use.idx, cast_output)
    value.type = ir.TensorType(FLOAT16)
    first_node = next(iter(graph), None)
    if first_node is None:
        graph.append(node)
    else:
        graph.insert_before(first_node, node)

"""Convert a model from image to image to float16, and keep in float32 what would show: measured.

WebGPU adds up in the dtype of its operands: a convolution of a few hundred float16 numbers is off
by several times what float16 rounds, and a deep network carries that on. So whatever adds many
numbers stays float32; of the rest, what can be rounded unseen is measured. All weights and both
images are float16 wherever possible: they are what is stored, and handed over.
"""

__all__ = ["HalvedImage", "halve_image"]

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import onnx_ir as ir

from gsgen.contract.probing.probes import Probe
from gsgen.sdk.float16.instrumented_model import HalfModel
from gsgen.sdk.float16.sensitivity_search import max_quantizable
from gsgen.sdk.float16.to_float16 import FLOAT, HALF, ToFloat16, halves, key_of
from gsgen.sdk.passes.framework.base import is_op, opset_of
from gsgen.sdk.passes.framework.graph_builder import free_name
from gsgen.sdk.rewriting.constant_subgraph import constant_nodes
from gsgen.sdk.rewriting.rewrite import prepare, tidy

# These add up more numbers than float16 can.
_SUMS = (
    *("Conv", "ConvTranspose", "MatMul", "Gemm", "Einsum", "Softmax", "LpNormalization"),
    *("InstanceNormalization", "LayerNormalization", "BatchNormalization", "CumSum"),
    *("ReduceSum", "ReduceMean", "ReduceL2", "ReduceSumSquare", "GlobalAveragePool"),
)
# What may be off for being computed in float16, as a share of the largest value: a quarter of what
# two devices may differ by (rule GB011).
_ROUNDING = 5e-4
# The same for weights, as a share of what the model as a whole may be off by.
_SHARE_OF_WEIGHTS = 0.5
_BUDGET = 24


@dataclass(frozen=True, slots=True)
class HalvedImage:
    """What became float16.

    Attributes:
        computed: How many nodes compute in it.
        kept: How many could, and do not.
        stored: How many weights are stored in it.
        kept_weights: Names of those that are not.
    """

    computed: int
    kept: int
    stored: int
    kept_weights: tuple[str, ...]


def halve_image(
    model: ir.Model,
    image: str,
    probes: Sequence[Probe],
    allowed: float,
    progress: Callable[[str], None],
) -> HalvedImage:
    """Convert ``model``, which is changed, and say what became float16.

    Args:
        model: Takes and gives float32 images.
        image: Name of the input that becomes float16.
        probes: Where to measure, with images that float16 holds.
        allowed: What the result may be off by, as a share of its largest value.
        progress: Called with a few words whenever a new stage begins.
    """
    prepare(model)
    measure = _Measure(model, probes)
    opset, once = opset_of(model), set(constant_nodes(model.graph))
    nodes = [n for n in model.graph if n not in once and halves(n, opset)]
    progress(f"measuring which of {len(measure.weights)} weights may be float16")
    tables = max_quantizable(
        range(len(measure.weights)),
        measure.of_weights,
        budget=_BUDGET,
        allowed=_SHARE_OF_WEIGHTS * allowed,
    )
    measure.stored = tables.quantized
    measure.rebase()
    progress(f"measuring which of {len(nodes)} nodes may round to float16")
    free = [k for k, node in enumerate(nodes) if not is_op(node, *_SUMS)]
    found = max_quantizable(free, measure.of_nodes, budget=_BUDGET, allowed=_ROUNDING)
    computed = {key_of(nodes[k]) for k in found.quantized}
    keep = {key_of(node) for node in nodes} - computed
    stored = {measure.weights[k] for k in tables.quantized}
    _halve_input(model.graph, image)
    ToFloat16(keep, outputs=True, stored=stored)(model)
    tidy(model)
    lost = tuple(name for name in measure.weights if name not in stored)
    return HalvedImage(len(computed), len(keep), len(stored), lost)


class _Measure:
    """Measures what rounding does to the image that comes out."""

    def __init__(self, model: ir.Model, probes: Sequence[Probe]) -> None:
        self._model, self._probes = HalfModel(model), probes
        self.weights, self.stored = self._model.weights, frozenset[int]()
        self.rebase()

    def rebase(self) -> None:
        """Compare with the weights as they are stored now from here on."""
        self._wanted = [self._made(one, (), self.stored) for one in self._probes]

    def of_weights(self, stored: Collection[int]) -> tuple[float, str]:
        """Return the largest error of storing these, as a share of the largest value of all."""
        largest = max(float(np.abs(one).max()) for one in self._wanted)
        return self._error((), stored, largest), "image"

    def of_nodes(self, chosen: Collection[int]) -> tuple[float, str]:
        """Return the same of computing these in float16, image by image as devices are compared."""
        return self._error(chosen, self.stored), "image"

    def _error(
        self, chosen: Collection[int], stored: Collection[int], largest: float = 0.0
    ) -> float:
        worst = 0.0
        for probe, wanted in zip(self._probes, self._wanted, strict=True):
            error = np.abs(self._made(probe, chosen, stored) - wanted).max()
            error = error / max(largest or float(np.abs(wanted).max()), 1e-6)
            worst = max(worst, float(error) if error <= np.inf else np.inf)
        return worst

    def _made(
        self, probe: Probe, chosen: Collection[int], stored: Collection[int]
    ) -> np.ndarray:
        flags = np.zeros(len(self._model.units), np.bool_)
        tables = np.zeros(len(self.weights), np.bool_)
        flags[list(chosen)], tables[list(stored)] = True, True
        given = {
            name: value.astype(np.float32) if value.dtype == np.float16 else value
            for name, value in probe.inputs.items()
        }
        (made,) = self._model.run(given, flags, tables).values()
        return made.astype(np.float64)


def _halve_input(graph: ir.Graph, name: str) -> None:
    """Take float16 where ``name`` was float32; the graph reads it as float32."""
    value = next(one for one in graph.inputs if one.name == name)
    node = ir.node("Cast", [value], attributes={"to": FLOAT.value})
    made = node.outputs[0]
    made.name = node.name = free_name(graph, f"{name}_as_float32")
    made.type, made.shape = ir.TensorType(FLOAT), value.shape
    readers = list(value.uses())
    for use in readers:
        if use.node is not node:
            use.node.replace_input_with(use.idx, made)
    value.type = ir.TensorType(HALF)
    front = next(iter(graph), None)
    if front is None:
        graph.append(node)
    else:
        graph.insert_before(front, node)

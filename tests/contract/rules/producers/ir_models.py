"""Models built with ``onnx_ir``: what moves Gaussians, input by input."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import onnx_ir as ir
from onnx import ModelProto

from contract.rules.producers.good import Good, declared, live, scene
from gsgen.contract.spec.manifest import Input, Tolerances

_COUNT = 48
_CODES = {"float32": ir.DataType.FLOAT, "int32": ir.DataType.INT32}


def _weight(name: str, array: np.ndarray) -> ir.Value:
    return ir.Value(name=name, const_value=ir.tensor(array, name=name))


class _Graph:
    """Nodes in the order in which they are asked for, and the weights that they use."""

    def __init__(self) -> None:
        self.nodes: list[ir.Node] = []
        self.weights: list[ir.Value] = []

    def weigh(self, name: str, array: np.ndarray) -> ir.Value:
        self.weights.append(_weight(name, array))
        return self.weights[-1]

    def do(self, op: str, *inputs: ir.Value, **attributes: Any) -> ir.Value:
        node = ir.node(op, inputs, attributes)
        self.nodes.append(node)
        return node.outputs[0]


def _moved(
    entry: Input, shape: tuple[int, ...], table: np.ndarray, steps: str, **changes: Any
) -> ModelProto:
    """Centres move by what ``steps``, the operators between input and table, make of it."""
    result = scene(_COUNT, 1, seed=len(steps))
    graph = _Graph()
    dtype = "int32" if steps == "Gather" else "float32"
    inputs = ir.Value(name=entry.name, type=ir.TensorType(_CODES[dtype]), shape=ir.Shape(shape))
    weights = graph.weigh("table", table)
    if steps == "Gather":
        shift = graph.do("Gather", weights, inputs, axis=0)
    else:
        value = inputs
        for op in steps.split():
            first = (weights,) if op in ("Mul", "MatMul") else ()
            value = graph.do(op, value, *first)
        shift = value
    center = graph.weigh("center", result.rows[:, :3])
    remaining = graph.weigh("rest", result.rows[:, 3:])
    rows = graph.do("Concat", graph.do("Add", center, shift), remaining, axis=1)
    first = graph.weigh("one", np.ones(1, np.float32))
    color = graph.do("Mul", graph.weigh("colors", result.colors), first)
    count = graph.do("Identity", graph.weigh("live", live(_COUNT)))
    for value, name, array in (
        (rows, "gaussians", result.rows),
        (color, "color", result.colors),
        (count, "num_points", live(_COUNT)),
    ):
        value.name, value.shape = name, ir.Shape(array.shape)
        value.dtype = _CODES[array.dtype.name]
    body = ir.Graph(
        [inputs],
        [rows, color, count],
        nodes=graph.nodes,
        initializers=graph.weights,
        opset_imports={"": 18},
        name="by_ir",
    )
    model = ir.to_proto(ir.Model(body, ir_version=10, producer_name="onnx_ir"))
    assert isinstance(model, ModelProto)
    return declared(model, result.manifest(entry, room=3.0, **changes))


def models() -> Iterator[Good]:
    """Yield a model for each input role that is no camera."""
    rng = np.random.default_rng(8)
    speed = rng.uniform(-0.1, 0.1, (_COUNT, 3)).astype(np.float32)
    frames = rng.uniform(-1, 1, (9, 3)).astype(np.float32)

    def one(
        name: str, entry: Input, shape: tuple[int, ...], table: np.ndarray, steps: str, **how: Any
    ) -> Good:
        draw = partial(_moved, entry, shape, table, steps, **how)
        return Good(name, "onnx_ir", draw, "webgpu")

    for low, high in ((0.0, 1.0), (-2.0, 2.0), (3.0, 10.0)):
        time = Input(name="time", role="time", range=(low, high), default=low)
        yield one(f"time {low}..{high}", time, (1,), speed, "Mul")
    turn = Input(name="time", role="time", range=(0.0, 6.2831855), default=0.0, loop=True)
    yield one("looping time", turn, (1,), speed, "Sin Mul")
    for role in ("frame_index", "appearance_id"):
        index = Input(name="which", role=role, range=(0.0, 8.0), default=4.0)
        yield one(role, index, (1,), frames, "Gather")
    eye = Input(name="eye", role="camera_position", default="zeros")
    yield one("camera position", eye, (3,), np.eye(3, dtype=np.float32), "MatMul Tanh")
    root = Input(name="root", role="root_translation", range=(-1.0, 1.0), default=(0.0, 0.0, 0.5))
    yield one("root translation", root, (3,), np.ones(3, np.float32), "Mul")
    betas = Input(name="betas", role="shape", shape=(10,), range=(-2.0, 2.0), default="zeros")
    basis = rng.uniform(-0.05, 0.05, (10, 3)).astype(np.float32)
    yield one("body shape", betas, (10,), basis, "MatMul")
    face = Input(name="face", role="expression", shape=(10,), range=(0.0, 1.0), default=(0.5,) * 10)
    yield one("expression", face, (10,), basis, "MatMul")
    slider = Input(name="explode", role="control", range=(0.0, 2.0), default=1.0, label="Explode")
    yield one("slider", slider, (1,), speed, "Mul", antialias="mip")
    loose_case = Tolerances(position=0.01)
    yield one("own tolerances", slider, (1,), speed, "Mul", tolerances=loose_case)

"""Models written message by message, as tools without a library for it do."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from onnx import AttributeProto, GraphProto, ModelProto, NodeProto, numpy_helper

from contract.rules.producers.good import UP, Good, Scene, declared, live, scene
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    CountOutput,
    FutureOutput,
    ImageOutput,
    Input,
    PostProcessManifest,
    PostProcessOutputs,
    Space,
    TrajectoryManifest,
    TrajectoryOutputs,
    UncertaintyOutput,
)

_CODES = {"float32": 1, "int32": 6, "int64": 7, "float16": 10}
_VIEW = Input(name="view", role="view", default="identity")


def _node(op: str, inputs: str, outputs: str, **attributes: int) -> NodeProto:
    node = NodeProto(op_type=op, input=inputs.split(), output=outputs.split())
    for name, value in attributes.items():
        node.attribute.add(name=name, i=value, type=AttributeProto.INT)
    return node


def _value(values, name: str, dtype: str, dims: tuple[int | str, ...]) -> None:
    kind = values.add(name=name).type.tensor_type
    kind.elem_type = _CODES[dtype]
    for dim in dims:
        entry = kind.shape.dim.add()
        if isinstance(dim, str):
            entry.dim_param = dim
        else:
            entry.dim_value = dim


def _model(graph: GraphProto, weights: dict[str, np.ndarray], opset: int) -> ModelProto:
    for name, array in weights.items():
        graph.initializer.append(numpy_helper.from_array(array, name))
    model = ModelProto(ir_version=8, producer_name="by hand", graph=graph)
    model.opset_import.add(version=opset)
    return model


def _generator(
    result: Scene,
    nodes: list[NodeProto],
    weights: dict[str, np.ndarray],
    *inputs: tuple[str, str, tuple[int, ...]],
    opset: int = 17,
) -> ModelProto:
    graph = GraphProto(name="by_hand", node=nodes)
    for name, dtype, dims in inputs:
        _value(graph.input, name, dtype, dims)
    dtype = "float16" if result.half else "float32"
    _value(graph.output, "gaussians", dtype, result.rows.shape)
    _value(graph.output, "color", dtype, result.colors.shape)
    _value(graph.output, "num_points", "int32", (1,))
    return _model(graph, weights, opset)


def _still(result: Scene, opset: int = 17, alive: int | None = None) -> ModelProto:
    """Weights that a Mul by one ends, so that the outputs survive a captured replay."""
    nodes = [
        _node("Mul", "rows one", "gaussians"),
        _node("Mul", "colors one", "color"),
        _node("Identity", "live", "num_points"),
    ]
    entry = np.ones(1, result.rows.dtype)
    count = live(len(result.rows) if alive is None else alive)
    rows, colors = result.rows.copy(), result.colors.copy()
    rows[count[0] :], colors[count[0] :] = 0, 0
    weights = {"rows": rows, "colors": colors, "live": count, "one": entry}
    return declared(_generator(result, nodes, weights, opset=opset), result.manifest())


def _seen(up: str, order: str, unit: str, color_space: str) -> ModelProto:
    """Opacity fades with depth, which is the third row of M times (centre, 1)."""
    result = scene(60, None, seed=UP.index(up))
    square = _node("Transpose" if order == "row" else "Identity", "view", "transposed")
    nodes = [
        square,
        _node("MatMul", "homogeneous transposed", "eye"),
        _node("MatMul", "eye third", "depth"),
        _node("Sigmoid", "depth", "fade"),
        _node("Mul", "opacity fade", "seen"),
        _node("Concat", "center seen spread", "gaussians", axis=1),
        _node("Mul", "colors one", "color"),
        _node("Identity", "live", "num_points"),
    ]
    ones = np.ones((60, 1), np.float32)
    weights = {
        "homogeneous": np.concatenate([result.rows[:, :3], ones], axis=1),
        "third": np.asarray([[0], [0], [1], [0]], np.float32),
        "center": result.rows[:, :3],
        "opacity": result.rows[:, 3:4],
        "spread": result.rows[:, 4:],
        "colors": result.colors,
        "one": ones[:1, 0],
        "live": live(60),
    }
    space = Space(up=up, unit=unit, matrix_order=order)
    manifest = result.manifest(_VIEW, space=space)
    appearance = AppearanceOutput("color", "rgb", None, color_space)
    outputs = replace(manifest.outputs, appearance=appearance)
    model = _generator(result, nodes, weights, ("view", "float32", (4, 4)))
    return declared(model, replace(manifest, outputs=outputs))


def _picture(
    channels: int, dtype: str, size: tuple[int | str, int | str], black_level: float
) -> ModelProto:
    """Gamma, or its neighbour: an image between ``black_level`` and 1 stays between them."""
    graph = GraphProto(name="tone", node=[_node("Mul", "image amount", "out")])
    dims = (1, channels, *size)
    _value(graph.input, "image", dtype, dims)
    _value(graph.output, "out", dtype, dims)
    ends = (black_level, 1.0)
    manifest = PostProcessManifest(
        name="tone",
        inputs=(Input(name="image", role="image"),),
        outputs=PostProcessOutputs(ImageOutput("out", dtype, ends)),
        image_range=ends,
    )
    weights = {"amount": np.asarray([0.75], dtype)}
    return declared(_model(graph, weights, 17), manifest)


def _straight_on(steps: int, past_steps: int) -> ModelProto:
    """The last two states are continued in a straight line; doubt grows with each step."""
    graph = GraphProto(
        name="straight_on",
        node=[
            _node("MatMul", "onwards past", "straight"),
            _node("Split", "straight widths", "place turn", axis=1),
            _node("Mul", "turn turn", "squares"),
            _node("ReduceSum", "squares along", "total", keepdims=1),
            _node("Add", "total tiny", "safe"),
            _node("Sqrt", "safe", "length"),
            _node("Div", "turn length", "unit"),
            _node("Concat", "place unit", "future", axis=1),
            _node("Expand", "doubt shape", "sigma"),
        ],
    )
    _value(graph.input, "past", "float32", (past_steps, 7))
    _value(graph.output, "future", "float32", (steps, 7))
    _value(graph.output, "sigma", "float32", (steps, 7))
    future_offsets = np.zeros((steps, past_steps), np.float32)
    future_offsets[:, -1] = 2 + np.arange(steps)
    future_offsets[:, -2] = -1 - np.arange(steps)
    uncertainty = 0.1 * np.arange(1, steps + 1, dtype=np.float32)[:, None]
    manifest = TrajectoryManifest(
        name="straight-on",
        inputs=(
            Input(name="past", role="camera_history", shape=(past_steps, 7), range=(-1.0, 1.0)),
        ),
        outputs=TrajectoryOutputs(
            FutureOutput("future", steps, "position+quaternion-wxyz"), UncertaintyOutput("sigma")
        ),
        step_seconds=1 / 30,
    )
    weights = {
        "onwards": future_offsets,
        "doubt": uncertainty,
        "shape": np.array([steps, 7]),
        "widths": np.array([3, 4]),
        "along": np.array([1]),
        "tiny": np.array([1e-12], np.float32),
    }
    return declared(_model(graph, weights, 17), manifest)


def _bounded_above() -> ModelProto:
    """Some rows before the count are inert, as ``upper-bound`` says."""
    result = scene(64, 0)
    result.rows[::4] = 0
    manifest = result.manifest()
    outputs = replace(manifest.outputs, count=CountOutput("num_points", "upper-bound"))
    return declared(_still(result), replace(manifest, outputs=outputs))


def models() -> Iterator[Good]:
    """Yield every layout that rows may have, every frame, and the companion kinds."""
    layouts = [(degree, np.float32) for degree in (0, 1, 2, 3, None)]
    layouts += [(degree, np.float16) for degree in (1, 3, None)]
    for number, (degree, dtype) in enumerate(layouts):
        shown = "rgb" if degree is None else f"sh{degree}"
        name = f"{shown} {np.dtype(dtype).name}"
        is_layout_valid = degree == 3 or (degree is None and dtype is np.float16)
        result = scene(256, degree, dtype, seed=number)
        target = "visionary" if is_layout_valid else "webgpu"
        yield Good(name, "protos", partial(_still, result), target)
    for count in (1, 7, 1000, 16_385):
        yield Good(f"{count} rows", "protos", partial(_still, scene(count, 0)), "webgpu")
    padded = partial(_still, scene(512, 2), alive=100)
    yield Good("100 of 512 rows live", "protos", padded, "webgpu")
    yield Good("upper bound", "protos", _bounded_above, "webgpu")
    for opset in (13, 20):
        yield Good(f"opset {opset}", "protos", partial(_still, scene(), opset))
    for index, up in enumerate(UP):
        order, unit = ("column", "row")[index % 2], ("metre", "arbitrary")[index // 3]
        color_space = ("srgb", "linear")[index // 2 % 2]
        name = f"up {up}, {order} matrices, {unit}, {color_space}"
        draw = partial(_seen, up, order, unit, color_space)
        yield Good(name, "protos", draw, "webgpu")
    for channels, dtype, size, black_level in (
        (3, "float32", (12, 8), 0.0),
        (4, "float16", (8, 8), 0.0),
        (3, "float32", ("h", "w"), -1.0),
    ):
        name = f"image {channels} {dtype} {size}"
        draw = partial(_picture, channels, dtype, size, black_level)
        yield Good(name, "protos", draw, "core" if dtype == "float16" else "webgpu")
    for steps, past_steps in ((1, 2), (5, 8)):
        draw = partial(_straight_on, steps, past_steps)
        yield Good(f"{steps} steps from {past_steps}", "protos", draw, "webgpu")

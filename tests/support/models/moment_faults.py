"""Models that are wrong at one named moment alone: NaN, an opaque padding row, a wrong count.

The moments follow from the manifest and the specification, not from the plan of the validator.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import onnx
from onnx import AttributeProto, NodeProto, TensorProto, numpy_helper

from gsgen.contract.spec.input_defaults import default_tensor
from gsgen.contract.spec.manifest import (
    GeneratorManifest,
    Input,
    Manifest,
    PostProcessManifest,
    TrajectoryManifest,
)

FAULTS = ("nan", "opaque padding", "wrong count")
_TOLERANCE = 1e-6
_UP = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Condition:
    """A number of the inputs that lies in an interval at one named moment.

    Attributes:
        input: The input.
        low: Lower end of the interval, for each element or for the sum.
        high: Its upper end.
        weights: Weights of a sum over the elements; None for every element by itself.
        modulus: The numbers are the sizes of the last two axes, modulo this, if it is not 0.
        any_element: One element in the interval suffices.
    """

    input: str
    low: np.ndarray
    high: np.ndarray
    weights: np.ndarray | None = None
    modulus: int = 0
    any_element: bool = False


@dataclass(frozen=True)
class Moment:
    """A named moment: a name and conditions that all hold there."""

    name: str
    conditions: tuple[Condition, ...]


def near(entry: Input, value: np.ndarray | float, shape: tuple[int, ...]) -> Condition:
    """Every element of an input equals a value, up to rounding of float32."""
    target = np.broadcast_to(np.asarray(value, np.float64), shape)
    room = _TOLERANCE * np.maximum(np.abs(target), 1)
    return Condition(entry.name, target - room, target + room)


def named_moments(
    manifest: Manifest, shapes: dict[str, tuple[int, ...]], open_sizes: frozenset[str]
) -> Iterator[Moment]:
    """Yield the moments that the manifest or the specification names."""
    order = "column"
    if isinstance(manifest, GeneratorManifest) and manifest.space is not None:
        order = manifest.space.matrix_order
    for entry in manifest.inputs:
        shape = shapes[entry.name]
        if entry.role == "camera_history":
            continue
        if entry.default is not None or entry.role not in ("view", "projection"):
            value = default_tensor(entry, shape)
            if order == "column" and entry.role in ("view", "projection", "image_view"):
                value = np.swapaxes(value, -1, -2)
            if entry.name not in open_sizes:
                yield Moment(f"default of {entry.name}", (near(entry, value, shape),))
        if entry.range is not None and entry.role not in ("image", "view", "projection"):
            for end, number in zip(("low", "high"), entry.range, strict=True):
                yield Moment(f"{end} end of {entry.name}", (near(entry, number, shape),))
        if entry.role == "time" and entry.range is not None and entry.frames:
            for frame in range(entry.frames):
                time = np.float32(entry.time_of_frame(frame))
                yield Moment(
                    f"frame {frame}", (Condition(entry.name, *[np.full(shape, time)] * 2),)
                )
        if entry.role == "frame_index" and entry.range is not None:
            for number in range(int(entry.range[0]), int(entry.range[1]) + 1):
                yield Moment(f"frame number {number}", (near(entry, number, shape),))
        if entry.role == "image":
            low, _ = getattr(manifest, "image_range", entry.range or (0.0, 1.0))
            yield Moment(
                "a black pixel",
                (
                    Condition(
                        entry.name, np.float64(low - 1e-6), np.float64(low + 1e-6), any_element=True
                    ),
                ),
            )
            if entry.name in open_sizes:
                yield from (
                    Moment(
                        f"no multiple of {k}",
                        (Condition(entry.name, np.float64(1), np.float64(k - 1), modulus=k),),
                    )
                    for k in (8, 16, 64)
                )
    yield from _corners(manifest, shapes)
    if isinstance(manifest, GeneratorManifest):
        yield from _cameras(manifest, order)


def _corners(manifest: Manifest, shapes: dict[str, tuple[int, ...]]) -> Iterator[Moment]:
    """Yield every combination of ends, of up to three numbers."""
    ranged = [
        entry for entry in manifest.inputs
        if entry.range is not None and entry.role in ("time", "control", "frame_index", "appearance_id", "timestep")
        and np.prod(shapes[entry.name]) == 1
    ]  # fmt: skip
    if not 2 <= len(ranged) <= 3 or any(
        entry.range is not None
        and entry not in ranged
        and entry.role not in ("image", "view", "projection")
        for entry in manifest.inputs
    ):
        return
    for corner in np.ndindex(*[2] * len(ranged)):
        conditions = tuple(
            near(entry, entry.range[end], shapes[entry.name])
            for entry, end in zip(ranged, corner, strict=True)
        )
        yield Moment(f"corner {corner}", conditions)


def _cameras(manifest: GeneratorManifest, order: str) -> Iterator[Moment]:
    """Yield cameras that look along `up`, that stand inside, and pictures that are tall or wide."""
    axis = manifest.space.up if manifest.space else "-y"
    up = np.zeros(3)
    up[_UP[axis[1]]] = 1.0 if axis[0] == "+" else -1.0
    bounds = manifest.bounds
    for entry in manifest.inputs:
        if not manifest.depends(entry):
            continue
        if entry.role == "view":
            weights = np.zeros((4, 4))
            weights[2, :3] = up  # row 2 of the matrix is the direction of the camera's z
            weights = weights.T if order == "column" else weights
            for words, sign in (("up", 1), ("down", -1)):
                yield Moment(
                    f"a camera that looks {words}",
                    (
                        Condition(
                            entry.name, np.float64(1 - 1e-5), np.float64(1 + 1e-5), sign * weights
                        ),
                    ),
                )
        if entry.role == "camera_position" and bounds is not None:
            low, high = np.array(bounds.min), np.array(bounds.max)
            if (low < high).all():
                yield Moment("a camera inside", (Condition(entry.name, low, high),))
        if entry.role == "viewport":
            weights = np.array([1.0, -1.0])
            for words, sign in (("landscape", 1), ("portrait", -1)):
                yield Moment(
                    words, (Condition(entry.name, np.float64(1), np.float64(1e9), sign * weights),)
                )


def _node(op: str, inputs: list[str], outputs: list[str], **attributes: int) -> NodeProto:
    entries = [
        AttributeProto(name=name, i=value, type=AttributeProto.INT)
        for name, value in attributes.items()
    ]
    return NodeProto(op_type=op, input=inputs, output=outputs, attribute=entries)


def with_fault(
    model: onnx.ModelProto, manifest: Manifest, moment: Moment, fault: str
) -> onnx.ModelProto:
    """Return a copy of a model that breaks at a moment, and nowhere else."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    graph, nodes = model.graph, []

    def constant(name: str, value: np.ndarray) -> str:
        graph.initializer.append(numpy_helper.from_array(value, name))
        return name

    hits = [
        _condition_nodes(condition, f"fault_{k}", nodes, constant)
        for k, condition in enumerate(moment.conditions)
    ]
    nodes.append(_node("Concat", hits, ["fault_all"], axis=0))
    nodes.append(_node("ReduceMin", ["fault_all"], ["fault_hit"], keepdims=0))
    nodes.append(_node("Cast", ["fault_hit"], ["fault_now"], to=TensorProto.BOOL))
    for name, change in _changes(model, manifest, fault, constant):
        plain = f"fault_plain_{name}"
        for node in graph.node:
            node.output[:] = [plain if output == name else output for output in node.output]
            node.input[:] = [plain if tensor == name else tensor for tensor in node.input]
        if plain not in {output for node in graph.node for output in node.output}:
            nodes.append(_node("Identity", [name + "_source"], [plain]))
            for tensor in graph.initializer:
                if tensor.name == name:
                    tensor.name = name + "_source"
        changed = change(plain, nodes)
        nodes.append(_node("Where", ["fault_now", changed, plain], [name]))
    for info in [value for value in graph.value_info if value.name.startswith("fault_plain")]:
        graph.value_info.remove(info)
    graph.node.extend(nodes)
    return model


def _condition_nodes(condition: Condition, name: str, nodes: list, constant: Callable) -> str:
    """Append nodes that compute float [1], 1 where a condition holds; return the tensor's name."""

    def add(op: str, inputs: list[str], suffix: str, **attributes: int) -> str:
        nodes.append(_node(op, inputs, [f"{name}_{suffix}"], **attributes))
        return f"{name}_{suffix}"

    if condition.modulus:
        shape = add("Shape", [condition.input], "shape", start=2)
        remainder = add(
            "Mod", [shape, constant(f"{name}_modulus", np.int64([condition.modulus]))], "rest"
        )
        value = add("Cast", [remainder], "value", to=TensorProto.FLOAT)
    else:
        value = add("Cast", [condition.input], "value", to=TensorProto.FLOAT)
    if condition.weights is not None:
        weighted = add(
            "Mul",
            [value, constant(f"{name}_weights", condition.weights.astype(np.float32))],
            "weighted",
        )
        value = add("ReduceSum", [weighted], "sum", keepdims=0)
    low = constant(f"{name}_low", np.asarray(condition.low, np.float32))
    high = constant(f"{name}_high", np.asarray(condition.high, np.float32))
    above = add("GreaterOrEqual", [value, low], "above")
    below = add("LessOrEqual", [value, high], "below")
    both = add("And", [above, below], "both")
    number = add("Cast", [both], "number", to=TensorProto.FLOAT)
    reduce = "ReduceMax" if condition.any_element or condition.modulus else "ReduceMin"
    held = add(reduce, [number], "held", keepdims=0)
    return add("Reshape", [held, constant(f"{name}_unit", np.int64([1]))], "one")


def _changes(
    model: onnx.ModelProto, manifest: Manifest, fault: str, constant: Callable
) -> Iterator[tuple[str, Callable[[str, list], str]]]:
    """Yield output name, and a function that appends the nodes of its faulty value."""
    outputs = {output.name: output.type.tensor_type for output in model.graph.output}

    def dtype(name: str) -> np.dtype:
        return np.dtype({TensorProto.FLOAT16: "float16"}.get(outputs[name].elem_type, "float32"))

    def multiplied(factor: float, name: str) -> Callable[[str, list], str]:
        def append(plain: str, nodes: list) -> str:
            weights = constant(f"fault_factor_{name}", np.array(factor, dtype(name)))
            nodes.append(_node("Mul", [plain, weights], [f"fault_changed_{name}"]))
            return f"fault_changed_{name}"

        return append

    if isinstance(manifest, TrajectoryManifest):
        yield manifest.outputs.future.name, multiplied(np.nan, manifest.outputs.future.name)
        return
    if isinstance(manifest, PostProcessManifest):
        yield manifest.outputs.image.name, multiplied(np.nan, manifest.outputs.image.name)
        return
    rows, count = manifest.outputs.gaussians, manifest.outputs.count
    assert rows is not None
    assert count is not None
    if fault == "nan":
        yield rows.name, multiplied(np.nan, rows.name)
        return
    number = rows.capacity + 1 if fault == "wrong count" else rows.capacity - 1

    def constant_count(_: str, nodes: list) -> str:
        return constant("fault_count", np.int32([number]))

    yield count.name, constant_count
    if fault == "opaque padding":

        def opaque_last_row(plain: str, nodes: list) -> str:
            last = np.zeros((rows.capacity, 10), bool)
            last[-1, 3] = True
            mask, half = (
                constant("fault_last", last),
                constant("fault_half", np.array(0.5, dtype(rows.name))),
            )
            nodes.append(_node("Where", [mask, half, plain], ["fault_opaque"]))
            return "fault_opaque"

        yield rows.name, opaque_last_row

"""Models written as Python functions with ``onnxscript``; arguments that are arrays become weights."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from onnx import ModelProto, numpy_helper
from onnxscript import FLOAT, script
from onnxscript import opset18 as op

from contract.rules.producers.good import Good, Scene, declared, live, scene
from gsgen.contract.spec.manifest import (
    ImageOutput,
    Input,
    Manifest,
    PostProcessManifest,
    PostProcessOutputs,
    Space,
)

_COUNT = 32


@script(default_opset=op)
def turned(pose, center, scale, rest, colors, alive, one):
    """Turn anisotropic Gaussians by one unit quaternion, covariances too: Σ = R S S Rᵀ."""
    w, x, y, z = op.Split(pose, axis=1, num_outputs=4)
    first = op.Concat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), axis=1)
    second = op.Concat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), axis=1)
    third = op.Concat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), axis=1)
    length = op.ReduceSum(pose * pose, keepdims=1)
    where = op.Where(op.Greater(length, one * 0.5), one, one * 0.0)
    rotation = op.Concat(first, second, third, axis=0) * where
    moved = op.MatMul(center, op.Transpose(rotation, perm=[1, 0]))
    axes = op.Unsqueeze(rotation, [0]) * op.Unsqueeze(scale, [1])
    sigma = op.MatMul(axes, op.Transpose(axes, perm=[0, 2, 1])) + op.Unsqueeze(rest, [0])
    flat = op.Reshape(sigma, [-1, 9])
    upper = op.Gather(flat, [0, 1, 2, 4, 5, 8], axis=1)
    opacity = op.Sigmoid(op.Slice(center, [0], [1], [1]))
    gaussians = op.Concat(moved, opacity, upper, axis=1)
    return gaussians, colors * one, op.Identity(alive)


@script(default_opset=op)
def shown(view, homogeneous, third, center, opacity, spread, colors, alive, one):
    """Hide what lies behind the camera; ``view`` holds the transposed matrix."""
    depth = op.MatMul(op.MatMul(homogeneous, view), third)
    front = op.Where(op.Greater(depth, one * 0.01), one, one * 0.0)
    gaussians = op.Concat(center, opacity * front, spread, axis=1)
    return gaussians, colors * one, op.Identity(alive)


@script(default_opset=op)
def pulsing(time, rows, colors, alive, one):
    """Swing along x; float16 rows are cast at the very end."""
    swing = 0.2 * op.Sin(6.2831853 * time)
    ahead = op.Pad(op.Reshape(swing, [1, 1]), [0, 0, 0, 9])
    return (op.CastLike(rows + ahead, one), op.CastLike(colors * 1.0, one), op.Identity(alive))


@script(default_opset=op)
def blurred(image, kernel):
    """Blur each channel by itself."""
    return op.Clip(op.Conv(image, kernel, group=3, pads=[1, 1, 1, 1]), 0.0, 1.0)


def _built(
    function: Any,
    weights: Mapping[str, np.ndarray],
    shapes: Mapping[str, tuple[int | str, ...]],
    outputs: Mapping[str, tuple[str, tuple[int | str, ...]]],
    manifest: Manifest,
) -> ModelProto:
    """Return the function as a model: weights are no inputs, outputs have their types."""
    model = function.to_model_proto(
        input_types=[FLOAT[shapes.get(name, ())] for name in _arguments(function)],
        output_types=[FLOAT[shape] for _, shape in outputs.values()],
        ir_version=10,
    )
    graph = model.graph
    retained = [value for value in graph.input if value.name not in weights]
    del graph.input[:]
    graph.input.extend(retained)
    for name, array in weights.items():
        graph.initializer.append(numpy_helper.from_array(array, name))
    renamed = dict(zip((o.name for o in graph.output), outputs, strict=True))
    for node in graph.node:
        node.output[:] = [renamed.get(name, name) for name in node.output]
        node.input[:] = [renamed.get(name, name) for name in node.input]
    codes = {"float32": 1, "float16": 10, "int32": 6}
    for value in graph.output:
        value.name = renamed[value.name]
        value.type.tensor_type.elem_type = codes[outputs[value.name][0]]
    return declared(model, manifest)


def _arguments(function: Any) -> list[str]:
    return [parameter.name for parameter in function.function_ir.inputs]


def _outputs(made: Scene) -> dict[str, tuple[str, tuple[int, ...]]]:
    dtype = "float16" if made.half else "float32"
    return {
        "gaussians": (dtype, made.rows.shape),
        "color": (dtype, made.colors.shape),
        "num_points": ("int32", (1,)),
    }


def _common(made: Scene) -> dict[str, np.ndarray]:
    alive = live(len(made.rows))
    return {"colors": made.colors, "alive": alive, "one": np.ones(1, np.float32)}


def _turned(degree: int | None, seed: int) -> ModelProto:
    result = scene(_COUNT, degree, seed=seed)
    rng = np.random.default_rng(seed)
    weights = _common(result) | {
        "center": result.rows[:, :3],
        "scale": rng.uniform(0.02, 0.2, (_COUNT, 3)).astype(np.float32),
        "rest": (1e-4 * np.eye(3)).astype(np.float32),
    }
    pose = Input(
        name="pose",
        role="pose",
        shape=(1, 4),
        default=(1.0, 0.0, 0.0, 0.0),
        convention="quaternion-wxyz",
    )
    manifest = result.manifest(pose, room=1.8, family="avatar")
    return _built(turned, weights, {"pose": (1, 4)}, _outputs(result), manifest)


def _shown(up: str, degree: int | None, seed: int) -> ModelProto:
    result = scene(_COUNT, degree, seed=seed)
    rows = result.rows
    ones = np.ones((_COUNT, 1), np.float32)
    weights = _common(result) | {
        "homogeneous": np.concatenate([rows[:, :3], ones], axis=1),
        "third": np.asarray([[0], [0], [1], [0]], np.float32),
        "center": rows[:, :3],
        "opacity": rows[:, 3:4],
        "spread": rows[:, 4:],
    }
    camera = Input(name="camera", role="view", default="identity")
    manifest = result.manifest(camera, space=Space(up=up, unit="metre"))
    model = _built(shown, weights, {"view": (4, 4)}, _outputs(result), manifest)
    return _renamed_input(model, "view", "camera")


def _renamed_input(model: ModelProto, old: str, new: str) -> ModelProto:
    for node in model.graph.node:
        node.input[:] = [new if name == old else name for name in node.input]
    model.graph.input[0].name = new
    return model


def _pulsing(degree: int | None, dtype: type, seed: int) -> ModelProto:
    packed = scene(256, degree, dtype, seed)
    weights = {
        "rows": packed.rows.astype(np.float32),
        "colors": packed.colors.astype(np.float32),
        "alive": live(256),
        "one": np.ones(1, dtype),
    }
    time = Input(name="time", role="time", range=(0.0, 1.0), default=0.0, loop=True, fps=30)
    manifest = packed.manifest(time, room=1.3)
    return _built(pulsing, weights, {"time": (1,)}, _outputs(packed), manifest)


def _blurred(size: tuple[int | str, int | str]) -> ModelProto:
    kernel = np.full((3, 1, 3, 3), 1 / 9, np.float32)
    manifest = PostProcessManifest(
        name="blur",
        inputs=(Input(name="image", role="image"),),
        outputs=PostProcessOutputs(ImageOutput("out")),
    )
    dims = (1, 3, *size)
    outputs = {"out": ("float32", dims)}
    return _built(blurred, {"kernel": kernel}, {"image": dims}, outputs, manifest)


def models() -> Iterator[Good]:
    """Yield avatars, culled scenes, swinging ones, and a blur."""
    for degree, seed in ((0, 1), (3, 2), (None, 3)):
        draw = partial(_turned, degree, seed)
        yield Good(f"turned, degree {degree}", "onnxscript", draw, "webgpu")
    for up, degree in (("-y", 3), ("+z", 3), ("+y", 1)):
        draw = partial(_shown, up, degree, 5)
        target = "visionary" if degree == 3 else "webgpu"
        yield Good(f"hidden behind the camera, up {up}", "onnxscript", draw, target)
    for degree, dtype in ((3, np.float16), (None, np.float16), (3, np.float32), (2, np.float32)):
        name = f"pulsing, degree {degree}, {np.dtype(dtype).name}"
        target = "webgpu" if degree == 2 else "visionary"
        yield Good(name, "onnxscript", partial(_pulsing, degree, dtype, 9), target)
    for size in ((16, 24), ("height", "width")):
        yield Good(f"blur {size}", "onnxscript", partial(_blurred, size))

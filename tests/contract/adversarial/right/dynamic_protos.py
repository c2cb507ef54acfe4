"""Right models that follow cameras, times, poses and sliders, as raw protobuf messages."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from onnx import TensorProto

from contract.adversarial.case import Draft, right_model
from contract.adversarial.companions import cell_model, post_process, trajectory
from contract.adversarial.drafts import declare, generator, static
from contract.adversarial.dynamic import (
    CAMERA_INPUTS,
    POSE_INPUT,
    camera_centre,
    colors_by_direction,
    directions,
    inside_frustum,
    packed_by_parts,
    posed,
    reach,
    rodrigues,
    turned_covariance,
)
from contract.adversarial.faults.consumers import wide_concat
from contract.adversarial.graph_builder import GraphBuilder, value_info
from contract.adversarial.scenes import Scene, rows, scene, sh_columns

TOOL = "raw protos"


def _lit(kind: str, *, by: str = "view", order: str = "column", dtype: str = "float32") -> Draft:
    """Colours follow the direction from the camera."""
    source = scene(kind, seed=70)
    graph = GraphBuilder()
    entry = {"name": "camera", "role": "view", "default": "identity"}
    if by == "view":
        view = graph.input("camera", [4, 4])
        if order == "row":
            view = graph.op("Transpose", view, perm=[1, 0])
        centre = camera_centre(graph, view)
    else:
        entry = {"name": "camera", "role": "camera_position", "default": "zeros"}
        centre = graph.reshape(graph.input("camera", [3]), 1, 3)
    where = graph.constant(source.position)
    color = colors_by_direction(graph, source, directions(graph, where, centre))
    packed = graph.constant(rows(source), dtype)
    if dtype == "float16":
        ones = graph.constant(np.ones((source.count, 1)))
        color = graph.cast(graph.op("Concat", color, ones, axis=1), "float16")
    stored = source.position.astype(dtype).astype(float)
    manifest = declare(
        source.count, stored.min(0), stored.max(0), space="rgb", dtype=dtype, inputs=[entry]
    )
    manifest["space"]["matrix_order"] = order
    return generator(graph, packed, color, manifest)


def _culled(kind: str) -> Draft:
    """Rows that the camera does not see have opacity zero; the count is an upper bound."""
    source = scene(kind, seed=71)
    graph = GraphBuilder()
    view, projection = graph.input("camera", [4, 4]), graph.input("proj", [4, 4])
    visible_mask = inside_frustum(graph, source.position, view, projection)
    opacity = graph.op("Mul", graph.constant(source.opacity[:, None]), visible_mask)
    parts = rows(source)
    packed = packed_by_parts(
        graph, graph.constant(parts[:, :3]), opacity, graph.constant(parts[:, 4:])
    )
    manifest = declare(
        source.count,
        source.position.min(0),
        source.position.max(0),
        inputs=CAMERA_INPUTS,
        semantics="upper-bound",
    )
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


def _compacted(kind: str) -> Draft:
    """Rows that the camera sees come first; the others are zero, and the count is exact."""
    source = scene(kind, seed=72)
    graph = GraphBuilder()
    view, projection = graph.input("camera", [4, 4]), graph.input("proj", [4, 4])
    visible_mask = inside_frustum(graph, source.position, view, projection)
    n = source.count
    graph.node(
        "TopK", [graph.reshape(visible_mask, n), graph.constant([n], "int64")], ["best", "order"]
    )
    live = graph.op("Gather", visible_mask, "order", axis=0)
    tables = graph.constant(rows(source)), graph.constant(sh_columns(source, 1))
    packed, color = (
        graph.op("Mul", graph.op("Gather", table, "order", axis=0), live) for table in tables
    )
    total = graph.op("ReduceSum", visible_mask, graph.constant([0], "int64"), keepdims=0)
    manifest = declare(
        n, source.position.min(0), source.position.max(0), degree=1, inputs=CAMERA_INPUTS
    )
    return generator(graph, packed, color, manifest, count=graph.cast(total, "int32"))


def _swinging(kind: str, entry: dict[str, Any], phase: Callable[[GraphBuilder, str], str]) -> Draft:
    """Rows swing along y by the sine of a phase."""
    source = scene(kind, seed=73)
    graph = GraphBuilder()
    dtype = "int32" if entry["role"] in ("frame_index", "appearance_id") else "float32"
    shape = entry.get("shape", [1])
    angle = phase(graph, graph.input(entry["name"], shape, dtype))
    share = np.zeros((source.count, 3))
    share[:, 1] = 0.15 * (1 - 0.5 * (np.arange(source.count) % 3))
    swing = graph.op("Mul", graph.op("Sin", angle), graph.constant(share))
    where = graph.op("Add", swing, graph.constant(source.position))
    parts = rows(source)
    packed = packed_by_parts(
        graph, where, graph.constant(parts[:, 3:4]), graph.constant(parts[:, 4:])
    )
    low, high = (
        source.position.min(0) - [0, 0.15, 0],
        source.position.max(0) + np.array([0, 0.15, 0]),
    )
    manifest = declare(source.count, low, high, inputs=[entry])
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


def _turns(factor: float) -> Callable[[GraphBuilder, str], str]:
    return lambda graph, value: graph.op("Mul", value, graph.constant(factor))


def _frames(count: int) -> Callable[[GraphBuilder, str], str]:
    def phase(graph: GraphBuilder, frame: str) -> str:
        table = 2 * np.pi * np.arange(count) / count
        return graph.op("Gather", graph.constant(table), frame, axis=0)

    return phase


def _basis(size: int) -> Callable[[GraphBuilder, str], str]:
    def phase(graph: GraphBuilder, value: str) -> str:
        weights = graph.constant(np.linspace(0.2, 0.6, size)[:, None])
        return graph.op("MatMul", graph.reshape(value, 1, size), weights)

    return phase


def _first(graph: GraphBuilder, size: str) -> str:
    max_size = graph.op("Max", graph.gather(size, [0], 0), graph.constant(1.0))
    return graph.op("Div", graph.constant(300.0), max_size)


SWINGS: list[tuple[str, str, dict[str, Any], Callable[[GraphBuilder, str], str]]] = [
    (
        "looping_time",
        "surface",
        {"name": "t", "role": "time", "range": [0, 2], "default": 0, "loop": True, "fps": 30},
        _turns(np.pi),
    ),
    (
        "open_time",
        "hair",
        {"name": "t", "role": "time", "range": [0, 1], "default": 0},
        _turns(2.0),
    ),
    (
        "frames",
        "cloud",
        {
            "name": "frame",
            "role": "frame_index",
            "range": [0, 11],
            "default": 0,
            "frames": 12,
            "fps": 24,
        },
        _frames(12),
    ),
    (
        "slider",
        "room",
        {
            "name": "wind",
            "role": "control",
            "shape": [1],
            "range": [0, 1],
            "default": 0.0,
            "label": "Wind",
        },
        _turns(2.0),
    ),
    (
        "appearances",
        "room",
        {"name": "day", "role": "appearance_id", "range": [0, 3], "default": 0},
        _frames(4),
    ),
    (
        "body_shape",
        "avatar",
        {"name": "beta", "role": "shape", "shape": [10], "range": [-2, 2], "default": "zeros"},
        _basis(10),
    ),
    (
        "expressions",
        "avatar",
        {"name": "psi", "role": "expression", "shape": [5], "range": [-1, 1], "default": "zeros"},
        _basis(5),
    ),
    (
        "viewport",
        "surface",
        {"name": "size", "role": "viewport", "shape": [2], "default": [1280, 720]},
        _first,
    ),
]


def _avatar(
    body: Callable[[GraphBuilder, Scene], tuple[str, str]], entries: list[dict[str, Any]]
) -> Draft:
    """Joints turn positions and covariances."""
    source = scene("avatar", seed=74)
    graph = GraphBuilder()
    for entry in entries:
        graph.input(entry["name"], entry.get("shape", [3]))
    where, turn = body(graph, source)
    upper = turned_covariance(graph, turn, source)
    packed = packed_by_parts(graph, where, graph.constant(source.opacity[:, None]), upper)
    low, high = reach(source)
    if len(entries) > 1:  # the whole body turns about the origin, then moves
        radius = np.linalg.norm(source.position, axis=1).max() + 0.5
        low, high = np.full(3, -radius), np.full(3, radius)
    manifest = declare(source.count, low, high, inputs=entries)
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


def _posed(graph: GraphBuilder, source: Scene) -> tuple[str, str]:
    return posed(graph, source, rodrigues(graph, "pose"))


def _rooted(graph: GraphBuilder, source: Scene) -> tuple[str, str]:
    turn = rodrigues(graph, graph.reshape("turn", 1, 3))
    back = graph.op("Transpose", graph.reshape(turn, 3, 3), perm=[1, 0])
    where = graph.op("MatMul", graph.constant(source.position), back)
    return graph.op("Add", where, "root"), turn


ROOT = [
    {
        "name": "turn",
        "role": "root_rotation",
        "convention": "axis-angle",
        "range": [-1.5, 1.5],
        "default": "zeros",
    },
    {"name": "root", "role": "root_translation", "range": [-0.5, 0.5], "default": "zeros"},
]


def _declared(edit: Callable[[dict[str, Any]], Any], kind: str = "surface") -> Draft:
    draft = static(scene(kind, seed=75))
    assert isinstance(draft.manifest, dict)
    edit(draft.manifest)
    return draft


def _linear(manifest: dict[str, Any]) -> None:
    manifest["outputs"]["appearance"]["color_space"] = "linear"


def _mip(manifest: dict[str, Any]) -> None:
    manifest["antialias"] = "mip"


def _extended(manifest: dict[str, Any]) -> None:
    manifest["x-studio"] = {"take": 7}
    manifest["outputs"]["gaussians"]["x-note"] = "front"


def _weights_listed_as_inputs() -> Draft:
    """Initialisers that are also graph inputs are weights, not inputs."""
    draft = static(scene("cloud", seed=76))
    for tensor in draft.proto.graph.initializer:
        dtype = "int32" if tensor.data_type == TensorProto.INT32 else "float32"
        draft.proto.graph.input.append(value_info(tensor.name, list(tensor.dims), dtype))
    return draft


def _with_another_output() -> Draft:
    draft = static(scene("hair", seed=76))
    node = draft.proto.graph.node.add(op_type="Exp", input=["gaussians"], output=["debug"])
    node.name = "debug"
    draft.proto.graph.output.append(value_info("debug", [64, 10], "float32"))
    return draft


def _weights_beside() -> Draft:
    source = scene("room", seed=77)
    draft = static(source)
    tensor = draft.proto.graph.initializer[0]
    content = tensor.raw_data
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in (("location", "weights.bin"), ("offset", 0), ("length", len(content))):
        tensor.external_data.add(key=key, value=str(value))
    return Draft(draft.proto, draft.manifest, {"weights.bin": content})


for kind in ("surface", "room", "cloud"):
    right_model(f"lit_by_view_{kind}", TOOL, kind, "trained", build=partial(_lit, kind))
right_model(
    "lit_by_row_major_view", TOOL, "surface", "trained", build=partial(_lit, "surface", order="row")
)
right_model(
    "lit_by_camera_position",
    TOOL,
    "surface",
    "trained",
    build=partial(_lit, "surface", by="position"),
)
right_model(
    "lit_in_half", TOOL, "avatar", "trained", build=partial(_lit, "avatar", dtype="float16")
)
for kind in ("surface", "room"):
    right_model(f"culled_{kind}", TOOL, kind, "trained", build=partial(_culled, kind))
    right_model(f"compacted_{kind}", TOOL, kind, "trained", build=partial(_compacted, kind))
for name, kind, entry, phase in SWINGS:
    right_model(
        f"swings_by_{name}", TOOL, kind, "trained", build=partial(_swinging, kind, entry, phase)
    )
right_model("posed_avatar", TOOL, "avatar", "trained", build=partial(_avatar, _posed, [POSE_INPUT]))
right_model("rooted_avatar", TOOL, "avatar", "trained", build=partial(_avatar, _rooted, ROOT))
right_model("linear_colors", TOOL, "surface", "trained", build=partial(_declared, _linear))
right_model("mip_antialias", TOOL, "hair", "trained", build=partial(_declared, _mip, "hair"))
right_model(
    "extension_fields", TOOL, "cloud", "trained", build=partial(_declared, _extended, "cloud")
)
right_model("weights_listed_as_inputs", TOOL, "cloud", "trained", build=_weights_listed_as_inputs)
right_model(
    "another_output", TOOL, "hair", "trained", build=_with_another_output, warnings=("GO017",)
)
right_model("weights_beside_the_model", TOOL, "room", "trained", build=_weights_beside)
right_model(
    "cells_of_a_room", TOOL, "room", "trained", build=lambda: cell_model(scene("room", seed=78))
)
right_model(
    "cells_some_hidden",
    TOOL,
    "surface",
    "trained",
    build=lambda: cell_model(scene("surface", seed=78), visibility=np.arange(16) % 4 > 0),
)
right_model("sharpens_pictures", TOOL, "post-process", "synthetic", build=post_process)
right_model(
    "sharpens_pictures_with_alpha",
    TOOL,
    "post-process",
    "synthetic",
    build=partial(post_process, layout=(1, 4, "h", "w"), strength=False),
)
right_model("continues_paths", TOOL, "trajectory-predictor", "synthetic", build=trajectory)
# The releases that the target names were measured to join 256 inputs right.
right_model(
    "concat_of_sixteen_webgpu",
    TOOL,
    "surface",
    "trained",
    build=partial(wide_concat, 16),
    target="webgpu",
)

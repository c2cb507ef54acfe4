"""Models that the contract allows, and that one consumer cannot take."""

from functools import partial
from typing import Any

import numpy as np
from onnx import GraphProto

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator
from contract.adversarial.dynamic import packed_by_parts
from contract.adversarial.graph_builder import GraphBuilder, value_info
from contract.adversarial.scenes import rows, scene, sh_columns

FAMILY = "consumers"

BINDING = Sentence("targets.md", "Bytes of one storage buffer binding.")
BUFFER = Sentence("targets.md", "Bytes of one buffer.")
WORKGROUPS = Sentence("targets.md", "Workgroups of one dispatch along an axis.")
SPLIT = Sentence("targets.md", "Outputs of one Split.")
CONCAT = Sentence("targets.md", "Inputs of one Concat; newer releases than the viewer's join any")
REPLAY = Sentence("targets.md", "kernels are recorded once and replayed")
VISIONARY = Sentence("targets.md", "| `visionary` | 1.0.1 | 13 to 22 | up to 10 | `ai.onnx` |")
WEBGPU = Sentence("targets.md", "| `webgpu` | 1.0 | 13 to 26 | up to 13 | `ai.onnx` |")


def _large(n: int, degree: int) -> Draft:
    """A model that repeats one Gaussian ``n`` times; it is judged without running."""
    graph = GraphBuilder()
    channels = 3 * (degree + 1) ** 2
    packed = graph.op(
        "Expand",
        graph.constant([[0, 0, 0, 0.9, 0.01, 0, 0, 0.01, 0, 0.01]]),
        graph.constant([n, 10], "int64"),
    )
    color = graph.op(
        "Expand", graph.constant(np.zeros((1, channels))), graph.constant([n, channels], "int64")
    )
    return generator(graph, packed, color, declare(n, [-1] * 3, [1] * 3, degree=degree))


for target in ("webgpu", "visionary"):
    fault(
        f"harmonics_exceed_a_binding_{target}",
        FAMILY,
        "Exported a million Gaussians of degree 3 in one buffer.",
        r"bind|134,?217,?728|128 ?MiB|buffer|bytes",
        build=partial(_large, 1_000_000, 3),
        sentence=BINDING,
        target=target,
        level="static",
    )
fault(
    "harmonics_exceed_a_buffer",
    FAMILY,
    "Exported three million Gaussians of degree 3 in one buffer.",
    r"buffer|268,?435,?456|256 ?MiB|bind|bytes",
    build=partial(_large, 3_000_000, 3),
    sentence=BUFFER,
    target="webgpu",
    level="static",
)
fault(
    "rows_exceed_the_workgroups",
    FAMILY,
    "Exported seventeen million Gaussians.",
    r"workgroup|rows|dispatch|bind|buffer",
    build=partial(_large, 17_000_000, 0),
    sentence=WORKGROUPS,
    target="gsgen",
    level="static",
)


def wide_concat(n: int) -> Draft:
    """A time that moves ``n`` blocks of rows, joined by one Concat."""
    source = scene("surface", seed=60)
    graph = GraphBuilder()
    time = graph.input("time", [1])
    packed, size = rows(source), source.count // 16
    blocks = []
    for block in range(16):
        part = graph.constant(packed[block * size : (block + 1) * size])
        opacity_offset = np.zeros(10)
        opacity_offset[1] = 0.02 * (block + 1)
        blocks.append(graph.op("Add", part, graph.op("Mul", time, graph.constant(opacity_offset))))
    joined = graph.op("Concat", *blocks[:n], axis=0)
    if n < 16:
        joined = graph.op("Concat", joined, *blocks[n:], axis=0)
    entry = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
    low, high = source.position.min(0), source.position.max(0) + np.array([0, 0.35, 0])
    manifest = declare(source.count, low, high, inputs=[entry])
    return generator(graph, joined, graph.constant(sh_columns(source, 3)), manifest)


def _wide_split() -> Draft:
    source = scene("surface", seed=60)
    graph = GraphBuilder()
    time = graph.input("time", [1])
    opacity_offset = np.zeros(10)
    opacity_offset[1] = 0.1
    moved = graph.op(
        "Add", graph.constant(rows(source)), graph.op("Mul", time, graph.constant(opacity_offset))
    )
    columns = [f"column_{index}" for index in range(10)]
    graph.node("Split", [moved], columns, axis=1, num_outputs=10)
    left = graph.op("Concat", *columns[:5], axis=1)
    right = graph.op("Concat", *columns[5:], axis=1)
    entry = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
    low, high = source.position.min(0), source.position.max(0) + np.array([0, 0.11, 0])
    manifest = declare(source.count, low, high, inputs=[entry])
    joined = graph.op("Concat", left, right, axis=1)
    return generator(graph, joined, graph.constant(sh_columns(source, 3)), manifest)


fault(
    "concat_of_sixteen_visionary",
    FAMILY,
    "Joined sixteen blocks of rows by one Concat.",
    r"concat",
    build=partial(wide_concat, 16),
    sentence=CONCAT,
    target="visionary",
)
fault(
    "split_into_ten_webgpu",
    FAMILY,
    "Split the rows into their ten columns at once.",
    r"split",
    build=_wide_split,
    sentence=SPLIT,
    target="webgpu",
)


def _branching() -> Draft:
    """An If on the time chooses between two tables of harmonics."""
    source = scene("surface", seed=61)
    graph = GraphBuilder()
    late_condition = graph.op("Greater", graph.input("time", [1]), graph.constant(0.5))
    condition = graph.reshape(late_condition)
    branches = []
    for name, factor in (("then", 1.0), ("else", 0.6)):
        table = graph.constant(factor * sh_columns(source, 3))
        branch = GraphProto(name=name)
        node = branch.node.add(op_type="Identity", input=[table], output=[f"{name}_color"])
        node.name = f"{name}_identity"
        branch.output.append(value_info(f"{name}_color", [64, 48], "float32"))
        branches.append(branch)
    graph.node("If", [condition], ["chosen"], then_branch=branches[0], else_branch=branches[1])
    color = graph.op("Mul", "chosen", graph.constant(1.0))
    entry = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(64, low, high, inputs=[entry])
    return generator(graph, graph.constant(rows(source)), color, manifest)


def _looping() -> Draft:
    """A Loop that adds to the rows as many times as the frame says."""
    source = scene("surface", seed=61)
    graph = GraphBuilder()
    frame = graph.input("frame", [1], "int32")
    trips = graph.reshape(graph.cast(frame, "int64"))
    body = GraphProto(name="body")
    body.input.append(value_info("iteration", [], "int64"))
    body.input.append(value_info("go_on", [], "bool"))
    body.input.append(value_info("before", [64, 10], "float32"))
    opacity_offset = np.zeros(10)
    opacity_offset[1] = 0.01
    step = graph.constant(opacity_offset)
    body.node.add(op_type="Identity", input=["go_on"], output=["still"], name="still")
    body.node.add(op_type="Add", input=["before", step], output=["after"], name="lift")
    body.output.append(value_info("still", [], "bool"))
    body.output.append(value_info("after", [64, 10], "float32"))
    start = graph.constant(rows(source))
    graph.node("Loop", [trips, graph.constant(True, "bool"), start], ["moved"], body=body)
    packed = graph.op("Mul", "moved", graph.constant(1.0))
    entry = {"name": "frame", "role": "frame_index", "range": [0, 7], "default": 0}
    low, high = source.position.min(0), source.position.max(0) + np.array([0, 0.08, 0])
    manifest = declare(64, low, high, inputs=[entry])
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


def _plane_sampling(opset: int) -> Draft:
    """Colours sampled from a plane at a place that moves with time."""
    source = scene("surface", seed=62)
    graph = GraphBuilder(opset=opset, ir_version=10 if opset > 18 else 9)
    time = graph.input("time", [1])
    random = np.random.default_rng(1)
    plane = graph.constant(random.normal(0, 0.3, (1, 3, 8, 8)))
    coordinates = graph.constant(np.clip(source.position[None, None, :, :2], -0.8, 0.8))
    shifted = graph.op("Add", coordinates, graph.op("Mul", time, graph.constant(0.2)))
    mode = "linear" if opset >= 20 else "bilinear"
    sampled = graph.op("GridSample", plane, shifted, mode=mode, align_corners=1)
    color = graph.op("Transpose", graph.reshape(sampled, 3, 64), perm=[1, 0])
    color = graph.op("Mul", color, graph.constant(1.0))
    entry = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(64, low, high, degree=0, inputs=[entry])
    return generator(graph, graph.constant(rows(source)), color, manifest)


def _uncapturable(kind: str) -> Draft:
    """Sorts visible rows by an operator that runs on the CPU."""
    source = scene("surface", seed=63)
    graph = GraphBuilder()
    time = graph.input("time", [1])
    if kind == "NonZero":
        late_condition = graph.op("Greater", graph.constant(np.linspace(0, 1, 64)), time)
        actual = graph.op("Shape", graph.op("NonZero", late_condition))
        number = graph.gather(actual, [1], 0)
        count = graph.cast(number, "int32")
        mask = graph.cast(graph.reshape(late_condition, 64, 1), "float32")
        reverse = graph.constant(np.arange(63, -1, -1), "int64")
        mask = graph.op("Gather", mask, reverse, axis=0)
        opacity = graph.op("Mul", graph.constant(source.opacity[:, None]), mask)
    else:
        angle = graph.op("Mul", time, graph.constant(np.full((64, 64), 0.01)))
        factor = graph.op("Det", graph.op("Add", graph.constant(np.eye(64)), angle))
        small = graph.op("Div", factor, graph.constant(4.0))
        opacity = graph.op("Mul", graph.constant(source.opacity[:, None]), small)
        count = None
    parts = rows(source)
    packed = packed_by_parts(
        graph, graph.constant(parts[:, :3]), opacity, graph.constant(parts[:, 4:])
    )
    entry = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
    low, high = source.position.min(0), source.position.max(0)
    manifest = declare(64, low, high, inputs=[entry])
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest, count=count)


CAPTURE: list[tuple[str, str, Any, str]] = [
    ("if_on_the_time", "Chooses between two tables with an If on the time.", _branching, r"\bIf\b|branch|captur|control flow"),
    ("loop_over_frames", "Adds a step for each frame in a Loop.", _looping, r"\bloop\b|captur|control flow|trip"),
    ("grid_sample_of_set_20", "Samples planes with GridSample of operator set 20.", partial(_plane_sampling, 20), r"GridSample|captur|opset|operator"),
    ("count_by_nonzero", "Counts live rows with NonZero.", partial(_uncapturable, "NonZero"), r"NonZero|captur"),
    ("determinant_on_the_cpu", "Uses Det, which the provider does not have.", partial(_uncapturable, "Det"), r"\bDet\b|captur|provider"),
]  # fmt: skip
for name, mistake, build, cause in CAPTURE:
    fault(f"{name}_webgpu", FAMILY, mistake, cause, build=build, sentence=REPLAY, target="webgpu")


def _versions(opset: int, ir_version: int) -> Draft:
    source = scene("surface", seed=64)
    graph = GraphBuilder(opset=opset, ir_version=ir_version)
    manifest = declare(64, source.position.min(0), source.position.max(0))
    return generator(
        graph, graph.constant(rows(source)), graph.constant(sh_columns(source, 3)), manifest
    )


fault(
    "operator_set_23_visionary",
    FAMILY,
    "Exported the newest operator set for a viewer of last year.",
    r"opset|operator set|\b23\b",
    build=partial(_versions, 23, 10),
    sentence=VISIONARY,
    target="visionary",
)
fault(
    "ir_version_11_visionary",
    FAMILY,
    "Saved with a newer IR version than the viewer reads.",
    r"\bIR\b|ir.version|\b11\b",
    build=partial(_versions, 18, 11),
    sentence=VISIONARY,
    target="visionary",
)
fault(
    "fused_operator_webgpu",
    FAMILY,
    "Saved the graph that ONNX Runtime had optimised for the CPU.",
    r"domain|com\.microsoft|nchwc",
    build=lambda: _fused(),
    sentence=WEBGPU,
    target="webgpu",
)


def _fused() -> Draft:
    source = scene("surface", seed=64)
    graph = GraphBuilder()
    graph.import_domain("com.microsoft", 1)
    color = graph.op("QuickGelu", graph.constant(sh_columns(source, 3)), domain="com.microsoft")
    manifest = declare(64, source.position.min(0), source.position.max(0))
    return generator(graph, graph.constant(rows(source)), color, manifest)

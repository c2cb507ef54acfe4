"""Deformations and skeletons by a wrong formula, in other units, or in another order."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from contract.adversarial.avatars import avatar_model, skinned
from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.drafts import declare, generator
from contract.adversarial.dynamic import POSE_INPUT, packed_by_parts, rodrigues, turned_covariance
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import Scene, rows, scene, sh_columns

FAMILY = "time and pose"
N = 400
HOLDS = Sentence(
    "manifest.md",
    "An axis-aligned box of all Gaussian centres for all inputs, checked with test inputs.",
)
TIME: dict[str, Any] = {"name": "time", "role": "time", "range": [0, 1], "default": 0.0}
MOTION = (
    r"jump|smooth|continu|teleport|(move|motion).{0,60}(far|more|most|small part|hundredth|between)",
)

Parts = Callable[[GraphBuilder, Scene, str], tuple[str, str, str]]


def _deformed(
    kind: str,
    parts: Parts,
    *,
    entry: dict[str, Any] | None = None,
    box: float = 0.0,
    declared: dict[str, Any] | None = None,
) -> Draft:
    """A scene whose positions, opacities and covariances a graph computes from a time."""
    source = scene(kind, seed=35, n=N)
    entry = entry or TIME
    graph = GraphBuilder()
    value = graph.input(
        entry["name"], [1], "int32" if entry["role"] == "frame_index" else "float32"
    )
    where, opacity, upper = parts(graph, source, value)
    packed = packed_by_parts(graph, where, opacity, upper)
    low, high = source.position.min(0) - box, source.position.max(0) + box
    manifest = declare(N, low, high, inputs=[entry], semantics="upper-bound")
    manifest.update(declared or {})
    return generator(graph, packed, graph.constant(sh_columns(source, 3)), manifest)


def _fixed(graph: GraphBuilder, source: Scene) -> tuple[str, str]:
    packed = rows(source)
    return graph.constant(packed[:, 3:4]), graph.constant(packed[:, 4:])


def _swings(graph: GraphBuilder, source: Scene, phase: str, reach_by: float) -> str:
    share = np.zeros((N, 3))
    share[:, 1] = reach_by * (1 - 0.5 * (np.arange(N) % 3))
    swing = graph.op("Mul", graph.op("Sin", phase), graph.constant(share))
    return graph.op("Add", swing, graph.constant(source.position))


def _clipped_time(graph: GraphBuilder, source: Scene, time: str) -> tuple[str, str, str]:
    low, high = graph.constant(0.0), graph.constant(1.0)
    clipped = graph.op("Clip", time, low, high)
    phase = graph.op("Mul", clipped, graph.constant(3.0))
    return _swings(graph, source, phase, 0.2), *_fixed(graph, source)


def _cubic(graph: GraphBuilder, source: Scene, time: str) -> tuple[str, str, str]:
    """A polynomial that was fitted on [0, 1]."""
    cube = graph.op("Mul", graph.op("Mul", time, time), time)
    velocity = np.random.default_rng(0).normal(0, 0.05, (N, 3))
    moved = graph.op("Mul", cube, graph.constant(velocity))
    return graph.op("Add", moved, graph.constant(source.position)), *_fixed(graph, source)


def _centres_in_frames(graph: GraphBuilder, source: Scene, time: str) -> tuple[str, str, str]:
    """Temporal centres in frames 1 … 300, and a time of 0 … 1."""
    centre = graph.constant(np.linspace(1, 300, N)[:, None])
    away = graph.op("Div", graph.op("Sub", time, centre), graph.constant(12.0))
    weight = graph.op("Exp", graph.op("Neg", graph.op("Mul", away, away)))
    opacity, upper = _fixed(graph, source)
    return graph.constant(source.position), graph.op("Mul", opacity, weight), upper


def _velocity_per_frame(graph: GraphBuilder, source: Scene, time: str) -> tuple[str, str, str]:
    """Velocities that were multiplied by the frame rate twice."""
    velocity = np.random.default_rng(0).normal(0, 1.5, (N, 3)) * 30
    moved = graph.op("Mul", time, graph.constant(velocity))
    return graph.op("Add", moved, graph.constant(source.position)), *_fixed(graph, source)


def _turned_scene(sign: float) -> Parts:
    """The scene turns about the y axis; its covariances turn by ``sign`` times the angle."""

    def parts(graph: GraphBuilder, source: Scene, time: str) -> tuple[str, str, str]:
        axis = graph.constant([[0.0, 1.5, 0.0]])
        turn = rodrigues(graph, graph.op("Mul", axis, time))
        flat = graph.reshape(turn, 3, 3)
        where = graph.op(
            "MatMul", graph.constant(source.position), graph.op("Transpose", flat, perm=[1, 0])
        )
        opacity, upper = _fixed(graph, source)
        if sign:
            opposite = rodrigues(
                graph, graph.op("Mul", graph.op("Mul", axis, time), graph.constant(sign))
            )
            upper = turned_covariance(graph, opposite, source)
        return where, opacity, upper

    return parts


def _sorted_as_words(graph: GraphBuilder, source: Scene, frame: str) -> tuple[str, str, str]:
    """Frames in the order of their file names: 0, 1, 10, 11, …, 2, 20, …"""
    order = sorted(range(24), key=str)
    phases = graph.constant(2 * np.pi * np.array(order) / 24)
    phase = graph.op("Gather", phases, frame, axis=0)
    return _swings(graph, source, phase, 0.6), *_fixed(graph, source)


def _key_behind_the_end(graph: GraphBuilder, source: Scene, time: str) -> tuple[str, str, str]:
    """Key frame k + 1 of the last moment does not exist."""
    last = graph.constant(4.0)
    index = graph.cast(graph.op("Floor", graph.op("Mul", time, last)), "int64")
    after = graph.op("Add", index, graph.constant([1], "int64"))
    keys = graph.constant(np.linspace(0, 2, 5))
    phase = graph.op("Gather", keys, after, axis=0)
    return _swings(graph, source, phase, 0.2), *_fixed(graph, source)


FRAMES = {
    "name": "frame",
    "role": "frame_index",
    "range": [0, 23],
    "default": 0,
    "frames": 24,
    "fps": 24,
}
LONG = {**TIME, "range": [0, 10]}
fault(
    "time_clipped_to_one",
    FAMILY,
    "Clips the time to [0, 1] and declares ten seconds.",
    r"(throughout|part|rest|beyond|after|only|ends?|most).{0,80}(range|time)|declared range",
    build=partial(_deformed, "surface", _clipped_time, entry=LONG, box=0.3),
)
fault(
    "polynomial_beyond_its_fit",
    FAMILY,
    "Declares ten seconds of a polynomial that was fitted to the first.",
    r"bounds|outside|centres within",
    build=partial(_deformed, "surface", _cubic, entry=LONG, box=0.2),
    sentence=HOLDS,
)
fault(
    "temporal_centres_in_frames",
    FAMILY,
    "Stored the temporal centres in frames and takes a time of 0 to 1.",
    r"opacit|transparent|visible|drawn|inert",
    build=partial(_deformed, "cloud", _centres_in_frames),
)
fault(
    "velocity_times_rate_twice",
    FAMILY,
    "Multiplied the velocities by the frame rate twice, and measured the bounds.",
    *MOTION,
    r"(small|tiny|size|σ|standard deviation).{0,80}(neighbou?r|spacing|apart|bounds)",
    build=partial(_deformed, "cloud", _velocity_per_frame, box=180.0),
)
for name, mistake, sign in (
    ("positions_turn_alone", "Turns the positions of the scene and not its covariances.", 0.0),
    ("covariances_turn_back", "Turns the covariances against the positions.", -1.0),
):
    for kind in ("surface", "hair"):
        fault(
            f"{name}_{kind}",
            FAMILY,
            mistake,
            r"covarianc.{0,100}(rotat|turn|follow)",
            build=partial(_deformed, kind, _turned_scene(sign), box=1.2),
        )
fault(
    "frames_sorted_as_words",
    FAMILY,
    "Read the frames in the order of their file names: 0, 1, 10, 11, …, 2, 20.",
    *MOTION,
    r"frame.{0,60}order",
    build=partial(_deformed, "surface", _sorted_as_words, entry=FRAMES, box=0.7),
)
fault(
    "key_frame_behind_the_end",
    FAMILY,
    "Interpolates to the next key frame, which the last moment has not.",
    r"index|out of|range|gather|bounds",
    build=partial(_deformed, "surface", _key_behind_the_end, box=0.3),
    sentence=Sentence("manifest.md", "Smallest and largest meaningful value, both included."),
)


def _avatar(body: Callable[[GraphBuilder, Scene], str], entry: dict[str, Any]) -> Draft:
    """An avatar; ``body`` gives the rotation vectors of its joints."""
    source = scene("avatar", seed=36, n=N)
    graph = GraphBuilder()
    graph.input("pose", entry["shape"])
    parts = skinned(graph, source, body(graph, source))
    return avatar_model(graph, source, parts, [entry])


TURN_WORDS = (
    r"(rotat|turn|angle|axis|axes|degree|convention|euler|sign|opposite|invers|transpos).{0,100}"
    r"(pose|joint|limb|declare|axis|axes|angle|vector)",
    r"pose.{0,80}(rotat|turn|angle|axis|read|declare)",
)
POSES: list[tuple[str, str, Callable[[GraphBuilder, Scene], str]]] = [
    (
        "pose_turns_the_other_way",
        "Reads rotation vectors of a left-handed engine.",
        lambda graph, _: graph.op("Neg", "pose"),
    ),
    (
        "pose_axes_in_another_order",
        "Reads the vectors as z x y.",
        lambda graph, _: graph.gather("pose", [2, 0, 1], 1),
    ),
    (
        "pose_read_joint_last",
        "Reshaped [4, 3] to [3, 4] and transposed, which mixes the joints.",
        lambda graph, _: graph.op("Transpose", graph.reshape("pose", 3, 4), perm=[1, 0]),
    ),
    (
        "pose_angle_halved",
        "Halves the angles on the way to a quaternion, and once more on the way back.",
        lambda graph, _: graph.op("Mul", "pose", graph.constant(0.5)),
    ),
]
for name, mistake, body in POSES:
    fault(name, FAMILY, mistake, *TURN_WORDS, build=partial(_avatar, body, POSE_INPUT))

"""Pieces of graphs that follow a camera, a time or a pose."""

__all__ = [
    "CAMERA_INPUTS",
    "POSE_INPUT",
    "camera_centre",
    "colors_by_direction",
    "directions",
    "inside_frustum",
    "packed_by_parts",
    "posed",
    "reach",
    "rodrigues",
    "turned_covariance",
]

from typing import Any

import numpy as np

from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import PIVOTS, Array, Scene, upper_triangle

CAMERA_INPUTS: list[dict[str, Any]] = [
    {"name": "camera", "role": "view", "default": "identity"},
    {"name": "proj", "role": "projection", "default": "identity"},
]
POSE_INPUT: dict[str, Any] = {
    "name": "pose",
    "role": "pose",
    "shape": [4, 3],
    "convention": "axis-angle",
    "range": [-1.5, 1.5],
    "default": "zeros",
}

_UPPER = [0, 1, 2, 4, 5, 8]


def camera_centre(graph: GraphBuilder, view: str) -> str:
    """Return c = −Rᵀ t, [1, 3], of a view matrix that is stored column-major."""
    turn = graph.gather(graph.gather(view, [0, 1, 2], 0), [0, 1, 2], 1)  # Rᵀ
    offset = graph.gather(graph.gather(view, [3], 0), [0, 1, 2], 1)  # tᵀ
    centre = graph.op("MatMul", offset, graph.op("Transpose", turn, perm=[1, 0]))
    return graph.op("Neg", centre)


def directions(graph: GraphBuilder, positions: str, centre: str) -> str:
    """Return unit directions, [N, 3], from a camera's centre to positions."""
    ray = graph.op("Sub", positions, centre)
    square = graph.op("Mul", ray, ray)
    length = graph.op("ReduceSum", square, graph.constant([1], "int64"), keepdims=1)
    return graph.op("Div", ray, graph.op("Sqrt", graph.op("Add", length, graph.constant(1e-8))))


def colors_by_direction(graph: GraphBuilder, source: Scene, direction: str) -> str:
    """Return RGB, [N, 3], that changes with the direction, between 0 and 1."""
    random = np.random.default_rng(4)
    base = np.log((source.rgb + 0.05) / (1.05 - source.rgb))
    weights = graph.constant(random.normal(0, 0.8, (3, 3)))
    change = graph.op("MatMul", direction, weights)
    return graph.op("Sigmoid", graph.op("Add", change, graph.constant(base)))


def inside_frustum(
    graph: GraphBuilder, positions: Array, view: str, projection: str, margin: float = 1.3
) -> str:
    """Return 1.0 or 0.0, [N, 1]: whether a camera sees a position, margin included."""
    homogeneous = graph.constant(np.c_[positions, np.ones(len(positions))])
    clip = graph.op("MatMul", graph.op("MatMul", homogeneous, view), projection)
    w = graph.gather(clip, [3], 1)
    limit = graph.op("Mul", w, graph.constant(margin))
    inside = graph.op("Greater", w, graph.constant(0.01))
    for column in (0, 1):
        distance = graph.op("Abs", graph.gather(clip, [column], 1))
        inside = graph.op("And", inside, graph.op("LessOrEqual", distance, limit))
    return graph.cast(inside, "float32")


def packed_by_parts(graph: GraphBuilder, position: str, opacity: str, upper: str) -> str:
    """Return rows, [N, 10]."""
    return graph.op("Concat", position, opacity, upper, axis=1)


def rodrigues(graph: GraphBuilder, vectors: str) -> str:
    """Return rotation matrices, [J, 3, 3], of rotation vectors, [J, 3]."""
    square = graph.op("Mul", vectors, vectors)
    total = graph.op("ReduceSum", square, graph.constant([1], "int64"), keepdims=1)
    angle = graph.op("Sqrt", graph.op("Add", total, graph.constant(1e-14)))
    axis = graph.op("Div", vectors, angle)
    cross = np.zeros((3, 9))
    cross[0, [5, 7]], cross[1, [2, 6]], cross[2, [1, 3]] = (-1, 1), (1, -1), (-1, 1)
    skew = graph.reshape(graph.op("MatMul", axis, graph.constant(cross)), -1, 3, 3)
    sine = graph.reshape(graph.op("Sin", angle), -1, 1, 1)
    versine = graph.op("Sub", graph.constant(1.0), graph.op("Cos", angle))
    squared = graph.op("Mul", graph.reshape(versine, -1, 1, 1), graph.op("MatMul", skew, skew))
    turn = graph.op("Add", graph.op("Mul", sine, skew), squared)
    return graph.op("Add", turn, graph.constant(np.eye(3)))


def turned_covariance(graph: GraphBuilder, turn: str, source: Scene) -> str:
    """Return xx … zz, [N, 6], of R Σ Rᵀ; ``turn`` is [N, 3, 3] or [1, 3, 3]."""
    upper = upper_triangle(source.scale, source.rotation)
    sigma = graph.constant(upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
    back = graph.op("Transpose", turn, perm=[0, 2, 1])
    both = graph.op("MatMul", graph.op("MatMul", turn, sigma), back)
    return graph.gather(graph.reshape(both, -1, 9), _UPPER, 1)


def posed(graph: GraphBuilder, source: Scene, joint_turns: str) -> tuple[str, str]:
    """Return positions, [N, 3], and the rotation of each row, [N, 3, 3].

    Args:
        graph: The graph.
        source: An avatar.
        joint_turns: Rotation matrices of its joints about their pivots, [J, 3, 3].
    """
    turn = graph.gather(joint_turns, source.joint, 0)
    pivot = PIVOTS[source.joint]
    arm = graph.constant((source.position - pivot)[:, :, None])
    moved = graph.reshape(graph.op("MatMul", turn, arm), -1, 3)
    return graph.op("Add", moved, graph.constant(pivot)), turn


def reach(source: Scene, margin: float = 0.0) -> tuple[Array, Array]:
    """Return the corners of the box that an avatar stays in, however its joints turn."""
    pivot = PIVOTS[source.joint]
    radius = np.linalg.norm(source.position - pivot, axis=1, keepdims=True) + margin
    return (pivot - radius).min(0), (pivot + radius).max(0)

"""Avatars whose pose or root moves them wrongly, too little, or not at all."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from contract.adversarial.avatars import avatar_model, skinned
from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.dynamic import POSE_INPUT, posed, rodrigues, turned_covariance
from contract.adversarial.graph_builder import GraphBuilder
from contract.adversarial.scenes import rows, scene

FAMILY = "time and pose"

NO_EFFECT = (
    r"(no|without|little|hardly any|below|nothing|not).{0,60}(effect|change|move|differ|visible|reach|depend)",
    r"(has|have) no effect|leads to no output|unused|ignored",
)


def _avatar(
    entries: list[dict[str, Any]],
    body: Callable[[GraphBuilder, Any], tuple[str, str]],
    shapes: list[tuple[int, ...]],
    *,
    room: float = 0.0,
) -> Draft:
    """An avatar whose positions and covariances a graph computes from its inputs."""
    source = scene("avatar", seed=12)
    graph = GraphBuilder()
    for entry, shape in zip(entries, shapes, strict=True):
        graph.input(entry["name"], shape)
    return avatar_model(graph, source, body(graph, source), entries, room=room)


def _positions_alone(graph: GraphBuilder, source: Any) -> tuple[str, str]:
    where, _ = posed(graph, source, rodrigues(graph, "pose"))
    return where, graph.constant(rows(source)[:, 4:])


def _skinned(graph: GraphBuilder, source: Any) -> tuple[str, str]:
    return skinned(graph, source, "pose")


def _covariance_turned_back(graph: GraphBuilder, source: Any) -> tuple[str, str]:
    where, turn = posed(graph, source, rodrigues(graph, "pose"))
    back = graph.op("Transpose", turn, perm=[0, 2, 1])
    return where, turned_covariance(graph, back, source)


def _degrees(graph: GraphBuilder, source: Any) -> tuple[str, str]:
    radians = graph.op("Mul", "pose", graph.constant(np.pi / 180))
    return skinned(graph, source, radians)


def _unsafe_axis(graph: GraphBuilder, source: Any) -> tuple[str, str]:
    """Rodrigues by an axis that is divided by its length without an epsilon."""
    square = graph.op("Mul", "pose", "pose")
    total = graph.op("ReduceSum", square, graph.constant([1], "int64"), keepdims=1)
    axis = graph.op("Div", "pose", graph.op("Sqrt", total))
    same = graph.op("Mul", axis, graph.op("Sqrt", total))
    return skinned(graph, source, same)


def _unused_pose(graph: GraphBuilder, source: Any) -> tuple[str, str]:
    zeros = graph.op("Mul", "pose", graph.constant(0.0))
    return skinned(graph, source, zeros)


fault(
    "pose_moves_positions_alone",
    FAMILY,
    "Skinned the positions and left the covariances in the rest pose.",
    r"covarianc.{0,100}(pose|turn|rotat|follow|rigid)|(pose|rotat).{0,100}covarianc",
    build=partial(_avatar, [POSE_INPUT], _positions_alone, [(4, 3)]),
)
fault(
    "pose_turns_covariances_backwards",
    FAMILY,
    "Turned the covariances by the inverse rotation, Rᵀ Σ R.",
    r"covarianc.{0,100}(pose|turn|rotat|follow|rigid)|(pose|rotat).{0,100}covarianc",
    build=partial(_avatar, [POSE_INPUT], _covariance_turned_back, [(4, 3)]),
)
fault(
    "pose_range_in_degrees",
    FAMILY,
    "Declared the range of the pose in degrees.",
    r"degree|radian|2 ?π|6\.28",
    build=partial(_avatar, [{**POSE_INPUT, "range": [-180, 180]}], _degrees, [(4, 3)]),
    sentence=Sentence("conventions.md", "Angles are radians everywhere."),
)
fault(
    "pose_taken_for_degrees",
    FAMILY,
    "The model takes degrees and the manifest declares ±1.5 radians, so joints hardly move.",
    r"degree|radian",
    *NO_EFFECT,
    build=partial(_avatar, [POSE_INPUT], _degrees, [(4, 3)]),
)
fault(
    "rest_pose_is_nan",
    FAMILY,
    "Divides the rotation vector by its length without an epsilon.",
    r"\bnan\b|finite|divi",
    build=partial(_avatar, [POSE_INPUT], _unsafe_axis, [(4, 3)]),
    sentence=Sentence(
        "roles.md", "A generator must give finite outputs when all its inputs are zero"
    ),
)
fault(
    "pose_without_effect",
    FAMILY,
    "The skinning weights were not loaded, so poses do nothing.",
    *NO_EFFECT,
    build=partial(_avatar, [POSE_INPUT], _unused_pose, [(4, 3)]),
)
fault(
    "smpl_convention_of_four_joints",
    FAMILY,
    "Declared SMPL's convention for a skeleton of four joints of its own.",
    r"smpl|\b24\b|joints",
    build=partial(_avatar, [{**POSE_INPUT, "convention": "smpl-axis-angle"}], _skinned, [(4, 3)]),
    sentence=Sentence("roles.md", "joints in the order of SMPL (J = 24) or SMPL-X (J = 55)"),
)
fault(
    "quaternion_convention_of_three_columns",
    FAMILY,
    "Declared quaternions for a pose of rotation vectors.",
    r"quaternion|convention|\[J, 4\]",
    build=partial(_avatar, [{**POSE_INPUT, "convention": "quaternion-wxyz"}], _skinned, [(4, 3)]),
    sentence=Sentence("roles.md", "`quaternion-wxyz`, [J, 4]: unit quaternions (w, x, y, z)"),
)

TRANSLATION: dict[str, Any] = {
    "name": "root",
    "role": "root_translation",
    "range": [-0.5, 0.5],
    "default": "zeros",
}
ROTATION: dict[str, Any] = {
    "name": "turn",
    "role": "root_rotation",
    "convention": "axis-angle",
    "range": [-1.5, 1.5],
    "default": "zeros",
}


def _rooted(order: str) -> Callable[[GraphBuilder, Any], tuple[str, str]]:
    def body(graph: GraphBuilder, source: Any) -> tuple[str, str]:
        turn = rodrigues(graph, graph.reshape("turn", 1, 3))
        flat = graph.op("Transpose", graph.reshape(turn, 3, 3), perm=[1, 0])
        where, offset = graph.constant(source.position), "root"
        if order == "translate first":
            where = graph.op("MatMul", graph.op("Add", where, offset), flat)
        else:
            if order == "centimetres":
                offset = graph.op("Mul", offset, graph.constant(0.01))
            where = graph.op("Add", graph.op("MatMul", where, flat), offset)
        used = graph.constant(np.eye(3)[None]) if order == "positions alone" else turn
        return where, turned_covariance(graph, used, source)

    return body


ROOT_ORDERS = [
    (
        "root_translated_before_it_is_rotated",
        "Added the root's translation before rotating.",
        "translate first",
        r"translat.{0,100}(rotat|order|before|after)|rotat.{0,100}translat",
        Sentence(
            "roles.md",
            "rotates the body, centres and covariances, about its root before it is translated:",
        ),
    ),
    (
        "root_translation_in_centimetres",
        "The model takes the translation in centimetres.",
        "centimetres",
        r"translat.{0,100}(unit|scale|centimet|factor|100|0\.01|by that)|unit",
        Sentence(
            "roles.md", "**root_translation**: added to the body after posing, in local units."
        ),
    ),
    (
        "root_rotation_of_positions_alone",
        "The root's rotation turns positions and not covariances.",
        "positions alone",
        r"covarianc.{0,100}(pose|turn|rotat|follow|rigid)|rotat.{0,100}covarianc",
        None,
    ),
]
for name, mistake, order, words, sentence in ROOT_ORDERS:
    fault(
        name,
        FAMILY,
        mistake,
        words,
        build=partial(_avatar, [ROTATION, TRANSLATION], _rooted(order), [(3,), (3,)], room=0.9),
        sentence=sentence,
    )


def _turned_by_matrix(*, transposed: bool) -> Callable[[GraphBuilder, Any], tuple[str, str]]:
    def body(graph: GraphBuilder, source: Any) -> tuple[str, str]:
        matrix = "turn"
        if transposed:
            matrix = graph.op("Transpose", "turn", perm=[1, 0])
        back = graph.op("Transpose", matrix, perm=[1, 0])
        where = graph.op("MatMul", graph.constant(source.position), back)
        return where, turned_covariance(graph, graph.reshape(matrix, 1, 3, 3), source)

    return body


fault(
    "root_matrix_transposed",
    FAMILY,
    "Multiplied by the root's matrix from the wrong side, so it turns backwards.",
    r"transpos|backwards|invers|opposite|M p",
    build=partial(
        _avatar,
        [{"name": "turn", "role": "root_rotation", "convention": "matrix", "default": "identity"}],
        _turned_by_matrix(transposed=True),
        [(3, 3)],
        room=0.4,
    ),
    sentence=Sentence("roles.md", "a rotation matrix M (`matrix`) that maps p to M p."),
)


def _quaternion_pose(order: list[int], epsilon: float) -> Draft:
    entry = {
        "name": "pose",
        "role": "pose",
        "shape": [4, 4],
        "convention": "quaternion-wxyz",
        "default": "identity",
    }

    def body(graph: GraphBuilder, source: Any) -> tuple[str, str]:
        square = graph.op("Mul", "pose", "pose")
        total = graph.op("ReduceSum", square, graph.constant([1], "int64"), keepdims=1)
        if epsilon:
            total = graph.op("Add", total, graph.constant(epsilon))
        unit = graph.op("Div", "pose", graph.op("Sqrt", total))
        scalar = graph.gather(unit, [order[0]], 1)
        vector = graph.gather(unit, order[1:], 1)
        double_vector = graph.op("Mul", vector, graph.constant(2.0))
        cross = np.zeros((3, 9))
        cross[0, [5, 7]], cross[1, [2, 6]], cross[2, [1, 3]] = (-1, 1), (1, -1), (-1, 1)
        skew = graph.reshape(graph.op("MatMul", vector, graph.constant(cross)), -1, 3, 3)
        doubled_output = graph.reshape(
            graph.op("MatMul", double_vector, graph.constant(cross)), -1, 3, 3
        )
        first = graph.op("Mul", graph.reshape(scalar, -1, 1, 1), doubled_output)
        turn = graph.op("Add", first, graph.op("MatMul", skew, doubled_output))
        turn = graph.op("Add", turn, graph.constant(np.eye(3)))
        where, turned = posed(graph, source, turn)
        return where, turned_covariance(graph, turned, source)

    return _avatar([entry], body, [(4, 4)])


fault(
    "pose_quaternions_xyzw",
    FAMILY,
    "Reads the quaternions of the pose as (x, y, z, w), so the rest pose is upside down.",
    r"xyzw|wxyz|quaternion|identity|rest",
    build=partial(_quaternion_pose, [3, 0, 1, 2], 1e-12),
)
fault(
    "zero_quaternion_is_nan",
    FAMILY,
    "Normalises quaternions without an epsilon, so zeroed inputs give NaN.",
    r"\bnan\b|finite|divi",
    build=partial(_quaternion_pose, [0, 1, 2, 3], 0.0),
    sentence=Sentence(
        "roles.md", "A generator must give finite outputs when all its inputs are zero"
    ),
)

"""Readings of a joint's numbers as a rotation, right and wrong ones, and which explains a motion."""

__all__ = [
    "Reading",
    "affine_motion",
    "angles_of",
    "covariance_errors",
    "declared_rotation",
    "explain_turns",
    "rigid_motion",
]

from collections.abc import Callable, Sequence
from itertools import permutations, product
from typing import Final, NamedTuple

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.spec.geometry import rotation_matrix, symmetric

# A joint turns as read if the matrix differs from that of the reading by at most this share of the
# latter's difference from the identity. Euler angles of 0.8 radians differ by 0.17 and more.
_MAX_ANGLE_ERROR = 0.05
# A covariance is compared if it should change by this share of its size.
_MIN_COVARIANCE_CHANGE = 0.1
# The smallest share of joints that turn as a wrong reading says, while at most the second turn as
# declared: all and none in models that break the rules, none and all in right ones.
_MIN_EXPLAINED_SHARE, _MAX_DECLARED_SHARE = 0.8, 0.1


class Reading(NamedTuple):
    """A wrong way to read the numbers of a joint.

    Attributes:
        name: The mistake in words.
        is_certain: Whether no choice of a joint's rest frame would give the same motion.
        hint: How to repair the model.
        line: The line of torch that undoes the mistake in the input ``pose``, or nothing.
    """

    name: str
    is_certain: bool
    hint: str
    line: str = ""


Matrix = Callable[[Float[np.ndarray, " w"]], Float[np.ndarray, "3 3"]]


def _axis_angle(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    half_angle = np.linalg.norm(vector) / 2
    scale = np.sinc(half_angle / np.pi) / 2
    return np.asarray(rotation_matrix(np.array([[np.cos(half_angle), *(scale * vector)]]))[0])


def _quaternion(values: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    return np.asarray(rotation_matrix(values[None])[0])


def _turned_axes(order: tuple[int, ...], signs: tuple[int, ...]) -> Matrix:
    return lambda vector: _axis_angle(vector[list(order)] * np.array(signs))


def _about_axes(order: tuple[int, ...]) -> Matrix:
    """Return the reading of Euler angles: the product of turns about the axes of local space."""

    def matrix(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        first, second, third = (_axis_angle(vector * np.eye(3)[axis]) for axis in order)
        return np.asarray(first @ second @ third)

    return matrix


def _first_order(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    return np.eye(3) + np.cross(np.eye(3), vector)


def _line_of_axes(order: tuple[int, ...], signs: tuple[int, ...]) -> str:
    """Return the line that gives a model, which exchanges axes so, what it makes the vector of."""
    axes = [order.index(axis) for axis in range(3)]
    factors = [signs[axis] for axis in axes]
    return f"pose[:, -3:] = pose[:, -3:][:, {axes}] * torch.tensor({factors})"


_RIGHT_MATRIX_OF_WIDTH: Final[dict[int, Matrix]] = {3: _axis_angle, 4: _quaternion}
_INVERSE_HINT = (
    "Multiply each column of centres by the matrix R from the left, or rows from the right by its "
    "transpose: as it is, R is transposed once too often."
)
# Rest frames of joints are the author's, and may exchange axes: those readings prove no mistake.
_AXES: Final[dict[Reading, Matrix]] = {
    Reading(
        f"axes were read as {' '.join(('−' if sign < 0 else '') + 'xyz'[axis] for axis, sign in zip(order, signs, strict=True))}",
        is_certain=False,
        hint="Give the rotation vectors in the axes of `space`, x y z, right-handed.",
        line=_line_of_axes(order, signs),
    ): _turned_axes(order, signs)
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if (order, signs) not in (((0, 1, 2), (1, 1, 1)), ((0, 1, 2), (-1, -1, -1)))
}  # fmt: skip
_WRONG_READINGS_OF_WIDTH: Final[dict[int, dict[Reading, Matrix]]] = {
    3: {
        Reading(
            "radians were taken for degrees",
            is_certain=True,
            hint="Remove the factor π/180: a runtime feeds radians.",
            line="pose = pose * 57.29577951308232",
        ): lambda v: _axis_angle(v * np.pi / 180),
        Reading(
            "radians were multiplied by 180/π",
            is_certain=True,
            hint="Remove the factor 180/π: sine and cosine take radians, which a runtime feeds.",
            line="pose = pose / 57.29577951308232",
        ): lambda v: _axis_angle(v * 180 / np.pi),
        Reading(
            "rotations were inverted", is_certain=True, hint=_INVERSE_HINT, line="pose = -pose"
        ): lambda v: _axis_angle(-v),
        Reading(
            "angles were halved",
            is_certain=True,
            hint="Use sin θ and cos θ in Rodrigues' formula, sin(θ/2) and cos(θ/2) in a quaternion.",
            line="pose = pose * 2",
        ): lambda v: _axis_angle(v / 2),
        Reading(
            "angles were doubled",
            is_certain=True,
            hint="Use sin(θ/2) and cos(θ/2) in a quaternion, sin θ and cos θ in Rodrigues' formula.",
            line="pose = pose / 2",
        ): lambda v: _axis_angle(v * 2),
        Reading(
            "the matrix were I + [v]×, which holds for small angles",
            is_certain=True,
            hint="Use Rodrigues' formula, I + sin θ / θ [v]× + (1 − cos θ) / θ² [v]×².",
        ): _first_order,
        **{
            Reading(
                f"the numbers were Euler angles, R = {' '.join('R' + 'xyz'[axis] for axis in order)}",
                is_certain=True,
                hint="Compute one matrix of the rotation vector by Rodrigues' formula: its length is "
                "the angle, its direction the axis.",
            ): _about_axes(order)
            for order in permutations(range(3))
        },
        **_AXES,
    },
    4: {
        Reading(
            "quaternions w x y z were read as x y z w",
            is_certain=True,
            hint="Read the first of the four numbers as w, and the others as x y z.",
            line="pose = pose[:, [1, 2, 3, 0]]",
        ): lambda q: _quaternion(np.roll(q, 1)),
        Reading(
            "rotations were inverted",
            is_certain=True,
            hint=_INVERSE_HINT,
            line="pose[:, 1:] = -pose[:, 1:]",
        ): lambda q: _quaternion(q * [1, -1, -1, -1]),
        **{
            reading: (lambda q, m=matrix: m(_vector_of(q)))  # type: ignore[misc]
            for reading, matrix in _AXES.items()
        },
    },
}


def _vector_of(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3"]:
    """Return axis times angle of a quaternion (w, x, y, z) with w above 0."""
    sine = float(np.linalg.norm(quaternion[1:]))
    angle = 2 * np.arctan2(sine, quaternion[0])
    return np.asarray(quaternion[1:] * (angle / max(sine, np.finfo(float).tiny)))


def angles_of(matrices: Float[np.ndarray, "... 3 3"]) -> Float[np.ndarray, "..."]:
    """Return the angles of rotation matrices, in radians, precise for small ones, too."""
    sines = np.stack(
        [matrices[..., i, j] - matrices[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
    )
    cosine = np.trace(matrices, axis1=-2, axis2=-1) - 1
    return np.asarray(np.arctan2(np.linalg.norm(sines, axis=0), cosine))


def explain_turns(
    turns: Sequence[tuple[Float[np.ndarray, " w"], Float[np.ndarray, "3 3"]]],
) -> tuple[Reading, float] | None:
    """Return the wrong reading that fits nearly all turns, and its share; None if none does.

    Args:
        turns: The three or four numbers that each joint was given, and the matrix that was seen.
    """
    widths = {len(values) for values, _ in turns}
    if len(widths) != 1 or not widths <= _RIGHT_MATRIX_OF_WIDTH.keys():
        return None
    width = widths.pop()
    if _share_that_fits(turns, _RIGHT_MATRIX_OF_WIDTH[width]) > _MAX_DECLARED_SHARE:
        return None
    scores = (
        (reading, _share_that_fits(turns, matrix))
        for reading, matrix in _WRONG_READINGS_OF_WIDTH[width].items()
    )
    best = max(scores, key=lambda score: score[1])
    return best if best[1] >= _MIN_EXPLAINED_SHARE else None


def _share_that_fits(
    turns: Sequence[tuple[Float[np.ndarray, " w"], Float[np.ndarray, "3 3"]]], matrix: Matrix
) -> float:
    # A reading may turn joints at rest, too: each joint's motion is seen from its parent's.
    width = len(turns[0][0])
    at_rest = matrix(np.eye(1, width)[0] * float(width == 4))
    expected = np.stack([matrix(values.astype(np.float64)) @ at_rest.T for values, _ in turns])
    seen = np.stack([rotation for _, rotation in turns])
    differences = [
        np.linalg.norm(seen - frame @ expected @ frame.T, axis=(1, 2))
        for frame in (np.eye(3), at_rest)
    ]
    limits = _MAX_ANGLE_ERROR * np.linalg.norm(expected - np.eye(3), axis=(1, 2))
    return float(np.mean(np.min(differences, axis=0) <= limits))


def declared_rotation(values: Float[np.ndarray, " w"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation that a joint's three numbers (axis-angle) or four (w x y z) stand for."""
    return _RIGHT_MATRIX_OF_WIDTH[len(values)](values)


def rigid_motion(
    rest: Float[np.ndarray, "n 3"], turned: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Return rotation and translation of the best rigid motion between points (Kabsch 1976)."""
    centers = rest.mean(axis=0), turned.mean(axis=0)
    left, _, right = np.linalg.svd((turned - centers[1]).T @ (rest - centers[0]))
    left[:, 2] *= np.sign(np.linalg.det(left @ right)) or 1.0
    rotation = left @ right
    return rotation, centers[1] - rotation @ centers[0]


def affine_motion(
    rest: Float[np.ndarray, "n 3"], moved: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Return matrix and translation of the affine motion between points, by least squares."""
    columns = np.column_stack([rest, np.ones(len(rest))])
    solution = np.linalg.lstsq(columns, moved, rcond=None)[0]
    return solution[:3].T, solution[3]


def covariance_errors(
    rotation: Float[np.ndarray, "3 3"],
    before: Float[np.ndarray, "n 6"],
    after: Float[np.ndarray, "n 6"],
) -> Float[np.ndarray, "3 k"]:
    """Return how far covariances are from R Σ Rᵀ, from Σ, and from Rᵀ Σ R, where these differ.

    The unit is the change that R Σ Rᵀ makes: 0 where they follow, 1 where they stay.
    """
    first, last = symmetric(before), symmetric(after)
    turned = rotation @ first @ rotation.T
    change = np.linalg.norm(turned - first, axis=(1, 2))
    counts = change > _MIN_COVARIANCE_CHANGE * np.linalg.norm(first, axis=(1, 2))
    expected = np.stack([turned, first, rotation.T @ first @ rotation])[:, counts]
    return np.asarray(np.linalg.norm(last[counts] - expected, axis=(2, 3)) / change[counts])

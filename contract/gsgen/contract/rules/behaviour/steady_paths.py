"""How predicted states leave a path of constant speed, and which reading of them explains it."""

__all__ = ["MAX_STEP_ERROR", "NEXT_STATES", "UNDOING_LINES", "W_LAST", "fault_of_steady_path"]

from itertools import pairwise
from typing import Final

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.spec.fields.roles import STATE_SIZES
from gsgen.contract.spec.geometry import quaternion_product, rotation_quaternion, rotation_vector

_POSITION_COLUMNS = slice(0, 3)
_ROTATION = slice(3, None)
# The first predicted motion may be off by this share of the history's: right models by less than
# 0.1, a trained one by 0.19 at eight times the speed that it saw, those that stay by 1, that damp by
# half by 0.5, and axes exchanged or negated by 0.9 or more. The motions to the other next states
# may be off by twice that, and brake by a part of a step each: a state told twice brakes by 1.
# Predictors that learned what people do brake more and more, since some of those stop: to 0.1 after
# 20 states. There the whole way counts, not a step of it, within half of what it may be.
MAX_STEP_ERROR = 0.25
_MAX_LATER_ERROR, _MAX_BRAKING = 0.5, 0.3
NEXT_STATES = 5
# Another reading of states explains a fault if it leaves at most this error: 0 to 0.1 where it does.
_MAX_EXPLAINED_ERROR = 0.1
_FARTHEST_FIRST: Final = "states come farthest first; nearest first is right"
W_LAST: Final = "quaternions are written in the order x y z w"
_INVERSES: Final = "quaternions are written as their inverses"
UNDOING_LINES: Final = {
    _FARTHEST_FIRST: "rows = rows.flip(0)",
    W_LAST: "rows = rows[:, [0, 1, 2, 6, 3, 4, 5]]",
    _INVERSES: "rows[:, 4:] = -rows[:, 4:]",
}
"""The line of torch that reads predicted states in another way, by the fault that it undoes."""
# The largest drift of places where only the rotation moves, and of rotations where only the place
# does, relative to their size: networks leave a little.
_MAX_CROSS_DRIFT = 0.02


def fault_of_steady_path(
    history: Float[np.ndarray, "t s"],
    future: Float[np.ndarray, "k s"],
    *,
    turning: bool,
    vertical: int | None = None,
) -> str:
    """Return how predictions leave a path of constant speed, and which reading explains it.

    Args:
        history: Past states of constant velocity, oldest first.
        future: Predicted states.
        turning: Whether the rotation goes on, rather than the place.
        vertical: The axis along which motion may be damped; None for no axis.
    """
    errors, along, across = _step_errors(history, future, turning=turning, vertical=vertical)
    if errors.max() <= MAX_STEP_ERROR:
        # The part of the states that rested stays at rest.
        rest = _POSITION_COLUMNS if turning else _ROTATION
        drift = np.abs(future[:, rest] - history[-1, rest]).max()
        if drift <= _MAX_CROSS_DRIFT * max(1.0, np.abs(history[-1, rest]).max()):
            return ""
        return f"it {'moves' if turning else 'turns'} too, by {drift:.2g} in the predicted states"
    # Explanations are tried: each is another reading, under which the same path goes on.
    readings = {_FARTHEST_FIRST: future[::-1]}
    if turning and future.shape[1] == STATE_SIZES["position+quaternion-wxyz"]:
        readings[W_LAST] = future[:, [0, 1, 2, 6, 3, 4, 5]]
        readings[_INVERSES] = future * [1, 1, 1, 1, -1, -1, -1]
    for words, states in readings.items():
        explained = _step_errors(history, states, turning=turning, vertical=vertical)[0].max()
        if explained <= _MAX_EXPLAINED_ERROR:
            return words
    number = int(np.argmax(errors > MAX_STEP_ERROR))
    start = "the state before" if number else "the newest state"
    if across[number] > max(MAX_STEP_ERROR, np.abs(along[number] - 1)):
        motion = f"{along[number]:.2g} steps on and {across[number]:.2g} aside of {start}"
        return f"predicted state {number + 1} is {motion}"
    if np.ptp(along) <= _MAX_EXPLAINED_ERROR:
        if abs(along[0]) <= _MAX_EXPLAINED_ERROR and abs(along[0]) > 0.001:
            return f"each state goes on by {along[0]:.3g} steps, a speed in another unit"
        speed = f"each state goes on by {along[0]:.2g} of the speed"
        return f"{speed}: the order of the history is reversed" if along[0] < 0 else speed
    return f"predicted state {number + 1} is {along[number]:.2g} steps on from {start}, not 1"


def _step_errors(
    history: Float[np.ndarray, "t s"],
    future: Float[np.ndarray, "k s"],
    *,
    turning: bool,
    vertical: int | None,
) -> Float[np.ndarray, "3 k"]:
    """Return each predicted step's error, its part along the history's step, and that across it.

    All are relative to the length of that step, from the newest two states of the history. The
    first predicted step goes on as that one; later ones do too, or brake. Errors of later steps are
    scaled to the limit of the first one.
    """
    states = np.vstack([history[-2:], future])
    if turning:
        quaternions = states[:, _ROTATION]
        if quaternions.shape[1] != STATE_SIZES["position+quaternion-wxyz"] - 3:
            quaternions = rotation_quaternion(quaternions)
        turns = [
            quaternion_product(later, earlier * [1, -1, -1, -1])
            for earlier, later in pairwise(quaternions)
        ]
        steps = rotation_vector(np.stack(turns))
    else:
        steps = np.diff(states[:, _POSITION_COLUMNS], axis=0)
        if vertical is not None:
            steps[:, vertical] = 0
    length = max(float(np.linalg.norm(steps[0])), np.finfo(np.float32).tiny)
    direction, motions = steps[0] / length, steps[1:] / length
    along = motions @ direction
    across = np.linalg.norm(motions - along[:, None] * direction, axis=1)
    lowest = np.clip(along[:-1] - _MAX_BRAKING, 0, 1)
    right = np.append(1.0, np.clip(along[1:], lowest, 1))
    errors = np.hypot(along - right, across)
    # Farther on: the way from the newest state, relative to that of a motion which does not brake.
    ways = motions.cumsum(axis=0)
    count = np.arange(1, len(ways) + 1)
    ways -= np.clip(ways @ direction, 0, count)[:, None] * direction
    errors[NEXT_STATES:] = (np.linalg.norm(ways, axis=1) / count)[NEXT_STATES:]
    errors[1:] *= MAX_STEP_ERROR / _MAX_LATER_ERROR
    return np.stack([errors, along, across])

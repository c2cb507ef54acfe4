"""Controls of a viewer: a camera that is turned, moved and brought back by hand."""

__all__ = ["Controls"]

import math
from dataclasses import replace
from typing import Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.spec.geometry import look_at
from gsgen.runtime.scene.camera import Camera

Vector = Float[np.ndarray, "3"]

_POLE: Final = math.radians(1.0)  # so near to straight up or down an orbit may come
_TURN: Final = math.radians(0.3)  # for each pixel that is dragged
_WHEEL: Final = 0.0012  # of the logarithm of the distance; a notch is 100
_SPEED: Final = 0.5  # of the reach, each second
_FAST: Final = 4.0
_NEAREST: Final = 1e-4  # of the reach: no wheel comes nearer to the pivot
_NEAR: Final = 0.01  # of the distance: the near plane is no farther than that

KEYS: Final = {
    "w": (0, 0, 1),
    "s": (0, 0, -1),
    "a": (-1, 0, 0),
    "d": (1, 0, 0),
    "q": (0, 1, 0),
    "e": (0, -1, 0),
}
"""Keys that move, and where to: right, down and forward."""


@final
class Controls:
    """A camera in somebody's hands.

    It turns about a pivot in front of it, which goes with it when it flies. How it is turned is
    kept as a rotation, so that cameras of files, which may be tilted, go on from where they are.

    Args:
        home: Where it begins.
        up: The world's upward direction.
        center: Of what is seen.
        reach: From there to the end of most of it.

    Attributes:
        pivot: What it turns about.
    """

    def __init__(self, home: Camera, up: Vector, center: Vector, reach: float) -> None:
        self._home = home
        self._up = np.asarray(up, np.float64) / np.linalg.norm(up)
        self._center, self._reach = np.asarray(center, np.float64), reach
        self.reset()

    def reset(self) -> None:
        """Go back to where it began."""
        self._turn = self._home.view[:3, :3].copy()  # world → camera
        self._zoom = 1.0
        ahead = float(self._turn[2] @ (self._center - self._home.eye))
        self._distance = ahead if ahead > _NEAREST * self._reach else self._reach
        if self._home.kind == "panorama":
            self._distance = (
                _NEAREST * self._reach
            )  # it stands in the middle, and looks around
        self.pivot = self._home.eye + self._distance * self._turn[2]

    @property
    def eye(self) -> Vector:
        """The camera centre, in world units."""
        return np.asarray(self.pivot - self._distance * self._turn[2])

    def camera(self, width: int, height: int) -> Camera:
        """Return the camera, in an image that shows at least what it showed in its own.

        Args:
            width: Of the image, in pixels.
            height: Of the image, in pixels.
        """
        home = self._home
        view = np.eye(4)
        view[:3, :3] = self._turn
        view[:3, 3] = -self._turn @ self.eye
        if home.kind == "panorama":
            return replace(home.scaled(width, height), view=view)
        scale = min(width / home.width, height / home.height)
        return replace(
            home,
            view=view,
            fx=home.fx * scale * self._zoom,
            fy=home.fy * scale * self._zoom,
            cx=width / 2 + (home.cx - home.width / 2) * scale,
            cy=height / 2 + (home.cy - home.height / 2) * scale,
            width=width,
            height=height,
            near=min(home.near, _NEAR * self._distance),
        )

    def orbit(self, right: float, down: float) -> None:
        """Turn about the pivot, as if what is seen were dragged by so many pixels."""
        if self._home.kind == "panorama":
            return self.look(right, down)
        self._rotate(right * _TURN, down * _TURN)

    def look(self, right: float, down: float) -> None:
        """Look around from where it is, as if what is seen were dragged by so many pixels."""
        eye = self.eye
        self._rotate(-right * _TURN, -down * _TURN)
        self.pivot = eye + self._distance * self._turn[2]

    def _rotate(self, around: float, over: float) -> None:
        """Turn about the upward direction, and then about the camera's own right."""
        turn = self._turn @ _rotation(self._up, around)
        # Which way up is leans by as much as the camera looks up; there is an end to that.
        angle = math.acos(float(np.clip(turn[2] @ self._up, -1, 1)))
        goal = float(np.clip(angle + over, min(angle, _POLE), max(angle, math.pi - _POLE)))
        turn = turn @ _rotation(turn[0], goal - angle)
        left, _, right = np.linalg.svd(turn)  # thousands of drags do not wear it out
        self._turn = left @ right

    def pan(self, right: float, down: float, width: int, height: int) -> None:
        """Drag what is at the pivot by so many pixels of an image of that size."""
        camera = self.camera(width, height)
        deep = {"pinhole": self._distance, "orthographic": 1.0, "panorama": self._reach}
        steps = -deep[camera.kind] * np.array([right / camera.fx, down / camera.fy, 0])
        self.pivot = self.pivot + self._turn.T @ steps

    def wheel(self, amount: float) -> None:
        """Come nearer to the pivot, or go away for a positive amount; 100 is a notch."""
        factor = math.exp(float(np.clip(amount * _WHEEL, -5, 5)))
        if self._home.kind == "orthographic":
            self._zoom = float(np.clip(self._zoom / factor, 1e-4, 1e4))
        elif self._home.kind == "pinhole":
            least, most = _NEAREST * self._reach, 1e4 * self._reach
            self._distance = float(np.clip(self._distance * factor, least, most))

    def fly(self, keys: frozenset[str], seconds: float, fast: bool) -> bool:
        """Move as the keys that are held say, and say whether that was anywhere."""
        steps = np.sum([KEYS[key] for key in keys if key in KEYS] or [(0, 0, 0)], axis=0)
        if not steps.any():
            return False
        length = _SPEED * self._reach * seconds * (_FAST if fast else 1)
        self.pivot = self.pivot + self._turn.T @ (steps / np.linalg.norm(steps)) * length
        return True

    def focus(self, point: Vector) -> None:
        """Look at a point from where it is, and turn about it from now on."""
        eye = self.eye
        ahead = np.asarray(point, np.float64) - eye
        distance = float(np.linalg.norm(ahead))
        if not distance > _NEAREST * self._reach:
            return
        if np.linalg.norm(np.cross(ahead / distance, self._up)) > math.sin(_POLE):
            self._turn = look_at(eye, np.asarray(point, np.float64), self._up)[:3, :3]
        self._distance, self.pivot = distance, np.asarray(point, np.float64)

    def frame(self) -> None:
        """Step to where everything is seen, without turning."""
        home = self._home
        self.pivot, self._zoom = self._center.copy(), 1.0
        if home.kind == "pinhole":
            half = math.atan(min(home.width / home.fx, home.height / home.fy) / 2)
            self._distance = self._reach / math.sin(half)


def _rotation(axis: Vector, angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation about an axis, right-handed (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(
        np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    )

"""Interactive camera controls: orbit, look around, pan, zoom and fly."""

__all__ = ["CAMERA_KEYS", "Controls", "unproject"]

import math
from dataclasses import replace
from typing import Final, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.spec.geometry import look_at
from gsgen.runtime.scene.camera import Camera

Vector = Float[np.ndarray, "3"]

_MIN_POLE_ANGLE: Final = math.radians(1.0)  # least angle between the view and straight up or down
_RADIANS_PER_PIXEL: Final = math.radians(0.3)  # per dragged pixel
_ZOOM_PER_WHEEL_UNIT: Final = 0.0012  # logarithm of the distance per wheel unit; a notch is 100
_MOVE_SPEED: Final = 0.5  # reaches per second
_SHIFT_SPEED_FACTOR: Final = 4.0  # factor of the speed with shift
_MIN_DISTANCE: Final = 1e-4  # reaches between the eye and the pivot
_NEAR_FRACTION: Final = 0.01  # distance of the near plane, relative to that of the pivot

CAMERA_KEYS: Final = {
    "w": (0, 0, 1),
    "s": (0, 0, -1),
    "a": (-1, 0, 0),
    "d": (1, 0, 0),
    "q": (0, 1, 0),
    "e": (0, -1, 0),
}
"""Keys that move the camera, with their direction: right, down and forward."""


@final
class Controls:
    """An interactive camera that orbits, pans, zooms and flies.

    The camera turns about a pivot in front of it, which moves with a flying camera. Its orientation
    is a rotation matrix, not two angles, so that tilted cameras of files keep their tilt.
    """

    def __init__(
        self, initial_camera: Camera, up: Vector, center: Vector, scene_radius: float
    ) -> None:
        self._initial_camera = initial_camera
        self._up_direction = np.asarray(up, np.float64) / np.linalg.norm(up)
        self._scene_center, self._scene_radius = np.asarray(center, np.float64), scene_radius
        self.reset()

    def reset(self) -> None:
        """Reset the camera to its first position and direction."""
        self._rotation = self._initial_camera.view[:3, :3].copy()  # world → camera
        self._zoom_factor = 1.0
        center_depth = float(self._rotation[2] @ (self._scene_center - self._initial_camera.eye))
        self._distance = (
            center_depth
            if center_depth > _MIN_DISTANCE * self._scene_radius
            else self._scene_radius
        )
        if self._initial_camera.kind == "panorama":
            self._distance = _MIN_DISTANCE * self._scene_radius  # a panorama turns in place
        self.pivot = self._initial_camera.eye + self._distance * self._rotation[2]

    @property
    def eye(self) -> Vector:
        """The camera centre, in world units."""
        return np.asarray(self.pivot - self._distance * self._rotation[2])

    def camera(self, width: int, height: int) -> Camera:
        """Return the camera at an image size; unzoomed, the whole initial view is in the image."""
        initial_camera = self._initial_camera
        view = np.eye(4)
        view[:3, :3] = self._rotation
        view[:3, 3] = -self._rotation @ self.eye
        if initial_camera.kind == "panorama":
            return replace(initial_camera.resized(width, height), view=view)
        scale = min(width / initial_camera.width, height / initial_camera.height)
        return replace(
            initial_camera,
            view=view,
            fx=initial_camera.fx * scale * self._zoom_factor,
            fy=initial_camera.fy * scale * self._zoom_factor,
            cx=width / 2 + (initial_camera.cx - initial_camera.width / 2) * scale,
            cy=height / 2 + (initial_camera.cy - initial_camera.height / 2) * scale,
            width=width,
            height=height,
            near=min(initial_camera.near, _NEAR_FRACTION * self._distance),
        )

    def orbit(self, right: float, down: float) -> None:
        """Turn the camera about its pivot by a mouse drag, in pixels."""
        if self._initial_camera.kind == "panorama":
            return self.look(right, down)
        self._rotate_view(right * _RADIANS_PER_PIXEL, down * _RADIANS_PER_PIXEL)

    def look(self, right: float, down: float) -> None:
        """Turn the camera in place by a mouse drag, in pixels."""
        eye = self.eye
        self._rotate_view(-right * _RADIANS_PER_PIXEL, -down * _RADIANS_PER_PIXEL)
        self.pivot = eye + self._distance * self._rotation[2]

    def _rotate_view(self, yaw: float, pitch: float) -> None:
        """Rotate the camera about the upward direction, then about its horizontal axis."""
        rotation = self._rotation @ _rotation(self._up_direction, yaw)
        # The angle to the upward direction avoids the poles, where the view would flip.
        angle = math.acos(float(np.clip(rotation[2] @ self._up_direction, -1, 1)))
        target = float(
            np.clip(
                angle + pitch, min(angle, _MIN_POLE_ANGLE), max(angle, math.pi - _MIN_POLE_ANGLE)
            )
        )
        rotation = rotation @ _rotation(rotation[0], target - angle)
        # The matrix is orthogonalised, so that rounding errors of many drags do not add up.
        left, _, right = np.linalg.svd(rotation)
        self._rotation = left @ right

    def pan(self, right: float, down: float, width: int, height: int) -> None:
        """Move the camera so that its pivot follows a mouse drag in pixels, for an image size."""
        camera = self.camera(width, height)
        depth = {"orthographic": 1.0, "panorama": self._scene_radius}
        steps = -depth.get(camera.kind, self._distance) * np.array(
            [right / camera.fx, down / camera.fy, 0]
        )
        self.pivot = self.pivot + self._rotation.T @ steps

    def wheel(self, amount: float) -> None:
        """Zoom by a mouse wheel amount: in if negative, out if positive; 100 is one notch."""
        factor = math.exp(float(np.clip(amount * _ZOOM_PER_WHEEL_UNIT, -5, 5)))
        if self._initial_camera.kind == "orthographic":
            self._zoom_factor = float(np.clip(self._zoom_factor / factor, 1e-4, 1e4))
        elif self._initial_camera.kind != "panorama":
            low, high = _MIN_DISTANCE * self._scene_radius, 1e4 * self._scene_radius
            self._distance = float(np.clip(self._distance * factor, low, high))

    def fly(self, keys: frozenset[str], seconds: float, *, is_fast: bool) -> bool:
        """Move the camera in the directions of the held keys, and return whether it moved."""
        steps = np.sum(
            [CAMERA_KEYS[key] for key in keys if key in CAMERA_KEYS] or [(0, 0, 0)], axis=0
        )
        if not steps.any():
            return False
        length = (
            _MOVE_SPEED * self._scene_radius * seconds * (_SHIFT_SPEED_FACTOR if is_fast else 1)
        )
        self.pivot = self.pivot + self._rotation.T @ (steps / np.linalg.norm(steps)) * length
        return True

    def focus(self, point: Vector) -> None:
        """Turn the camera towards a point, which becomes its pivot."""
        eye = self.eye
        direction_to_point = np.asarray(point, np.float64) - eye
        distance = float(np.linalg.norm(direction_to_point))
        if not distance > _MIN_DISTANCE * self._scene_radius:
            return
        if np.linalg.norm(np.cross(direction_to_point / distance, self._up_direction)) > math.sin(
            _MIN_POLE_ANGLE
        ):
            self._rotation = look_at(eye, np.asarray(point, np.float64), self._up_direction)[:3, :3]
        self._distance, self.pivot = distance, np.asarray(point, np.float64)

    def frame(self) -> None:
        """Move the camera until the whole scene is in view, without turning it."""
        initial_camera = self._initial_camera
        self.pivot, self._zoom_factor = self._scene_center.copy(), 1.0
        if initial_camera.kind in ("pinhole", "fisheye"):
            half_fov = (
                min(
                    initial_camera.width / initial_camera.fx,
                    initial_camera.height / initial_camera.fy,
                )
                / 2
            )
            is_fisheye = initial_camera.kind == "fisheye"
            half_fov = min(half_fov, math.pi / 2) if is_fisheye else math.atan(half_fov)
            self._distance = self._scene_radius / math.sin(half_fov)


def unproject(camera: Camera, x: float, y: float, depth: float) -> Vector:
    """Return the world position at a pixel and a depth of a camera's image."""
    x_slope, down = camera.plane_points(np.array([[x, y]]))[0]
    local = np.array([x_slope, down, 1.0]) * depth
    if camera.kind == "orthographic":
        local = np.array([x_slope, down, depth])
    elif camera.kind == "panorama":
        level = math.cos(down)
        local = depth * np.array(
            [math.sin(x_slope) * level, math.sin(down), math.cos(x_slope) * level]
        )
    elif camera.kind == "fisheye":
        angle = math.hypot(x_slope, down)
        outward = np.array([x_slope, down]) * float(np.sinc(angle / np.pi))
        local = depth * np.array([*outward, math.cos(angle)])
    return np.asarray(camera.eye + camera.view[:3, :3].T @ local)


def _rotation(axis: Vector, angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the right-handed rotation about a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    cross_matrix = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(
        np.eye(3)
        + math.sin(angle) * cross_matrix
        + (1 - math.cos(angle)) * cross_matrix @ cross_matrix
    )

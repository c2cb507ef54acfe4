"""Draws pictures of spaces: the axes of worlds, and of cameras."""

import numpy as np
from PIL import Image

from convention_pictures.sketch import (
    AXES,
    FAINT,
    INK,
    Dots,
    arrow,
    axes,
    beside,
    drawn,
    label,
    line,
    pixel,
    scene_of,
    write,
)
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

NAMES = ("x", "y", "z")


def world_axes(renderer: Renderer) -> Image.Image:
    """Draw two right-handed worlds with different upward axes."""
    return beside([_world(renderer, "-y"), _world(renderer, "+z")])


def _world(renderer: Renderer, up: str) -> Image.Image:
    axis = "xyz".index(up[1])
    upward = np.zeros(3)
    upward[axis] = -1.0 if up[0] == "-" else 1.0
    camera = Camera.orbit(
        (0, 0, 0),
        4.6,
        azimuth=35,
        elevation=24,
        up=upward.tolist(),
        width=380,
        height=300,
        fov_y=34,
    )
    across = np.linspace(-1, 1, 9)
    floor: list[Dots] = []
    u, v = (np.eye(3)[index] for index in range(3) if index != axis)
    for offset in across:
        floor += [
            line(offset * u - v, offset * u + v, 0.012, FAINT),
            line(offset * v - u, offset * v + u, 0.012, FAINT),
        ]
    picture = drawn(renderer, scene_of([*floor, *axes(np.zeros(3), 1.05, 0.035)]), camera)
    for index in range(3):
        label(picture, camera, 1.22 * np.eye(3)[index], f"+{NAMES[index]}", AXES[index])
    write(picture, (190, 286), f'"up": "{up}"', INK, 19)
    return picture


def camera_axes(renderer: Renderer) -> Image.Image:
    """Draw the axes of one camera in the conventions of OpenCV (gsgen's) and OpenGL."""
    opencv = np.eye(3)
    opengl = np.diag([1.0, -1, -1])
    return beside(
        [
            _camera(renderer, opencv, "OpenCV, COLMAP, gsgen"),
            _camera(renderer, opengl, "OpenGL, Blender, nerfstudio"),
        ]
    )


def _camera(renderer: Renderer, turn: np.ndarray, title: str) -> Image.Image:
    seen_by = Camera.look_at((-2.7, -1.5, -1.5), (0.1, 0.05, 0.45), width=380, height=300, fov_y=42)
    corners = [np.array([a * 0.55, b * 0.38, 1.3]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    body = [line(np.zeros(3), corner, 0.012, FAINT) for corner in corners]
    body += [
        line(a, b, 0.014, INK) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    picture = drawn(renderer, scene_of([*body, *axes(np.zeros(3), 0.8, 0.03, turn)]), seen_by)
    is_y_down = turn[1, 1] > 0
    meanings = ("right", "down", "forward") if is_y_down else ("right", "up", "backward")
    shifts = ((40, -4), (0, 16 if is_y_down else -16), (-12, 22) if is_y_down else (-18, 20))
    for index, (meaning, shift) in enumerate(zip(meanings, shifts, strict=True)):
        tip = 0.8 * turn[:, index]
        label(picture, seen_by, tip, f"{NAMES[index]} {meaning}", AXES[index], shift)
    label(picture, seen_by, corners[3], "image", INK, (10, 14))
    write(picture, (190, 16), title, INK, 19)
    return picture


def sh_directions(renderer: Renderer) -> Image.Image:
    """Draw the direction of SH colours: from the camera to the Gaussian."""
    camera = Camera.look_at(
        (0, -4.2, 0.001), (0, 0, 0), up=(0, 0, 1), width=420, height=400, fov_y=47
    )
    positions = [np.array([np.cos(a), 0, np.sin(a)]) * 1.45 for a in np.arange(8) * np.pi / 4]
    dots: list[Dots] = []
    for position in positions:
        dots += arrow(position * 0.93, position * 0.42, 0.02, FAINT)
    picture = drawn(
        renderer, scene_of([*dots, *axes(np.array([-1.25, 0, -1.25]), 0.4, 0.02)]), camera
    )
    for axis_index, shift in ((0, (14, 0)), (2, (0, -12))):
        tip = np.array([-1.25, 0, -1.25]) + 0.45 * np.eye(3)[axis_index]
        label(picture, camera, tip, NAMES[axis_index], AXES[axis_index], shift)
    row = np.zeros((1, 10), np.float32)
    row[0, 3], row[0, [4, 7, 9]] = 0.99, 0.06
    coefficients = np.zeros((1, 4, 3), np.float32)
    coefficients[0, 3] = (
        -1.0,
        0.0,
        1.0,
    )  # the x part: red where the direction is +x, blue where −x
    ball = Scene([SplatSet(SplatData(row, coefficients.reshape(1, 12), "sh"))])
    for position in positions:
        eye = Camera.look_at(position, (0, 0, 0), width=52, height=52, fov_y=50)
        view_image = drawn(renderer, ball, eye)
        x, y = (round(coordinate) for coordinate in pixel(camera, position * 1.12))
        picture.paste(view_image, (x - 26, y - 26))
    write(picture, (210, 200), "Gaussian", INK, 16)
    return picture

"""Draws pictures of the order of numbers: matrices in memory, and quaternions."""

import numpy as np
from PIL import Image, ImageDraw

from convention_pictures.sketch import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    RED,
    Dots,
    axes,
    beside,
    drawn,
    line,
    paper,
    scene_of,
    write,
)
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera

MATRIX = np.array([[1, 0, 0, 5], [0, 0, -1, 6], [0, 1, 0, 7], [0, 0, 0, 1]])
TRANSLATION = (RED, GREEN, BLUE)


def matrix_order(renderer: Renderer) -> Image.Image:
    """Draw a matrix, and its sixteen numbers in row-major and column-major order."""
    image = paper(680, 250)
    _cells(image, (20, 44), MATRIX, across=4)
    write(image, (20 + 2 * 34, 22), "M, as it is written", INK, 16)
    for name, numbers, y in (("column", MATRIX.T, 70), ("row", MATRIX, 170)):
        write(image, (200, y - 24), f'"{name}": memory, and tensor[0] to tensor[3]', INK, 16, "lm")
        _cells(image, (196, y), numbers, across=16, side=29)
    write(image, (20 + 2 * 34, 200), "coloured: t", INK, 15)
    return image


def _cells(
    image: Image.Image, corner: tuple[int, int], numbers: np.ndarray, across: int, side: int = 34
) -> None:
    pen = ImageDraw.Draw(image)
    for index, number in enumerate(numbers.ravel()):
        x, y = corner[0] + index % across * side, corner[1] + index // across * side
        color = TRANSLATION[number - 5] if number >= 5 else INK
        pen.rectangle([x, y, x + side, y + side], outline=FAINT)
        write(image, (x + side / 2, y + side / 2), str(number), color, 16)
        if across == 16 and index % 4 == 0:
            pen.line([(x, y - 4), (x, y + side + 4)], fill=INK, width=3)


def quaternions(renderer: Renderer) -> Image.Image:
    """Draw a rotation of 60° about z, read as (w, x, y, z) and wrongly as (x, y, z, w)."""
    half = np.radians(30)
    stored = np.array([np.cos(half), 0, 0, np.sin(half)])
    right = _board(renderer, stored, "read as w x y z: 60° about z")
    wrong = _board(renderer, stored[[3, 0, 1, 2]], "misread as x y z w: 120° about x")
    unturned = _board(renderer, np.array([1.0, 0, 0, 0]), "1 0 0 0: not turned")
    return beside([unturned, right, wrong], 6)


def _board(renderer: Renderer, quaternion: np.ndarray, title: str) -> Image.Image:
    w, x, y, z = quaternion
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    camera = Camera.look_at((1.4, -1.5, -3.6), (0, 0, 0), width=240, height=220, fov_y=38)
    corners = [
        turn @ np.array([a * 0.8, b * 0.4, 0]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    edges: list[Dots] = [
        line(a, b, 0.05, INK) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    picture = drawn(renderer, scene_of([*edges, *axes(np.zeros(3), 1.0, 0.022)]), camera)
    write(picture, (120, 14), title, INK, 14)
    return picture

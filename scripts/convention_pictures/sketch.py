"""Draws balls and arrows with the renderer, and labels on the picture."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

PAPER = (250, 250, 248)
INK = (40, 44, 52)
FAINT = (150, 154, 160)
RED, GREEN, BLUE = (214, 60, 52), (46, 150, 74), (48, 96, 208)
AXES = (RED, GREEN, BLUE)


@dataclass(frozen=True, slots=True)
class Dots:
    """Balls with positions, sizes and colours from 0 to 255."""

    position: np.ndarray
    radius: float
    color: np.ndarray

    @classmethod
    def at(cls, position: np.ndarray, radius: float, color: Sequence[float]) -> "Dots":
        """Return balls of one size and one colour."""
        centers = np.atleast_2d(np.asarray(position, float))
        return cls(centers, radius, np.tile(np.asarray(color, float), (len(centers), 1)))


def line(
    start: Sequence[float], end: Sequence[float], radius: float, color: Sequence[float]
) -> Dots:
    """Return a line of balls that touch each other."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    count = max(2, int(np.linalg.norm(b - a) / radius * 2))
    return Dots.at(a + np.linspace(0, 1, count)[:, None] * (b - a), radius, color)


def arrow(
    start: Sequence[float], end: Sequence[float], radius: float, color: Sequence[float]
) -> list[Dots]:
    """Return an arrow: a line of balls with a cone at the end."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    along = (b - a) / np.linalg.norm(b - a)
    side = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    side /= np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None]
    ring = np.cos(turn) * side + np.sin(turn) * np.cross(along, side)
    cone = [
        b - along * 7 * radius * share + 2.2 * radius * share * ring * fill
        for share in np.linspace(0, 1, 20)
        for fill in (0.3, 0.65, 1.0)
    ]
    return [
        line(a, b - along * 6 * radius, radius, color),
        Dots.at(np.concatenate(cone), 0.45 * radius, color),
    ]


def axes(
    origin: np.ndarray, length: float, radius: float, turn: np.ndarray | None = None
) -> list[Dots]:
    """Return arrows along x (red), y (green) and z (blue), the columns of ``turn``."""
    columns = np.eye(3) if turn is None else turn
    return [
        dots
        for axis in range(3)
        for dots in arrow(origin, origin + length * columns[:, axis], radius, AXES[axis])
    ]


def scene_of(dots: Iterable[Dots]) -> Scene:
    """Return the balls as a scene of Gaussians of about the same size."""
    several = list(dots)
    position = np.concatenate([dots.position for dots in several])
    rows = np.zeros((len(position), 10), np.float32)
    rows[:, :3], rows[:, 3] = position, 0.99
    variance = np.concatenate(
        [np.full(len(dots.position), (dots.radius / 2) ** 2) for dots in several]
    )
    rows[:, [4, 7, 9]] = variance[:, None]
    color = np.concatenate([dots.color for dots in several]).astype(np.float32) / 255
    return Scene([SplatSet(SplatData(rows, color, "rgb"))])


def drawn(renderer: Renderer, scene: Scene, camera: Camera) -> Image.Image:
    """Draw a scene on a white background."""
    behind = (*(channel / 255 for channel in PAPER), 1.0)
    rgba = renderer.render(scene, camera, background=behind).rgba
    assert rgba is not None
    return Image.fromarray((np.clip(rgba[..., :3], 0, 1) * 255 + 0.5).astype(np.uint8))


def paper(width: int, height: int) -> Image.Image:
    """Return an empty white image."""
    return Image.new("RGB", (width, height), PAPER)


def beside(pictures: Sequence[Image.Image], gap: int = 12) -> Image.Image:
    """Return pictures side by side as one image."""
    width = sum(picture.width for picture in pictures) + gap * (len(pictures) - 1)
    row, x = paper(width, max(picture.height for picture in pictures)), 0
    for picture in pictures:
        row.paste(picture, (x, 0))
        x += picture.width + gap
    return row


def write(
    picture: Image.Image,
    position: Sequence[float],
    text: str,
    color: tuple[int, int, int] = INK,
    size: int = 17,
    anchor: str = "mm",
) -> None:
    """Write ``text`` at a pixel, with a white outline."""
    ImageDraw.Draw(picture).text(
        (float(position[0]), float(position[1])),
        text,
        fill=color,
        font=ImageFont.load_default(size),
        anchor=anchor,
        stroke_width=2,
        stroke_fill=PAPER,
    )


def pixel(camera: Camera, point: Sequence[float]) -> np.ndarray:
    """Return the pixel at which a pinhole or an orthographic camera sees a point."""
    x, y, z = camera.view[:3, :3] @ np.asarray(point, float) + camera.view[:3, 3]
    distance = 1.0 if camera.kind == "orthographic" else z
    return np.array([camera.fx * x / distance + camera.cx, camera.fy * y / distance + camera.cy])


def label(
    picture: Image.Image,
    camera: Camera,
    point: Sequence[float],
    text: str,
    color: tuple[int, int, int] = INK,
    shift: tuple[float, float] = (0, 0),
) -> None:
    """Write a text at a point of the world."""
    write(picture, pixel(camera, point) + shift, text, color)

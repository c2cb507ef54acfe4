"""A synthetic scene in which left and right, up and down, near and far differ."""

import numpy as np

from convention_pictures.sketch import BLUE, GREEN, RED, Dots, line

YELLOW, VIOLET, TEAL = (232, 178, 32), (140, 84, 190), (24, 150, 160)


def room() -> list[Dots]:
    """Return a scene of objects on a tiled floor of 8 × 8; y is down, the floor is at y = 1.

    Ahead (+z) a red ball before a tower, to the right (+x) green, behind blue, to the left yellow.
    """
    return [*floor(), *tower((0.0, 3.2), VIOLET), *ball((0.9, 2.2), RED), *ball((2.8, 0.0), GREEN),
            *ball((0.0, -2.8), BLUE), *ball((-2.8, 0.0), YELLOW), *tower((-1.8, 2.2), TEAL)]  # fmt: skip


def floor(half: int = 4, step: float = 0.05) -> list[Dots]:
    """Return the floor: tiles of one unit, alternately light and dark."""
    side = np.arange(-half, half, step) + step / 2
    x, z = (axis.ravel() for axis in np.meshgrid(side, side))
    dark = (np.floor(x) + np.floor(z)) % 2 == 1
    color = np.where(dark[:, None], (120, 124, 130), (216, 214, 206))
    return [Dots(np.stack([x, np.ones_like(x), z], 1), 0.085, color.astype(float))]


def ball(ground: tuple[float, float], color: tuple[int, int, int]) -> list[Dots]:
    """Return a ball on the floor, made of many small balls, lighter above."""
    n = np.arange(2500) + 0.5
    height, turn = 1 - 2 * n / len(n), np.pi * (1 + np.sqrt(5)) * n  # Fibonacci's sphere
    level = np.sqrt(1 - height**2)
    around = np.stack([level * np.cos(turn), height, level * np.sin(turn)], 1)
    light = 0.75 - 0.35 * around[:, 1:2]
    center = np.array([ground[0], 0.55, ground[1]])
    return [Dots(center + 0.45 * around, 0.05, np.clip(np.array(color) * light * 1.25, 0, 255))]


def tower(ground: tuple[float, float], color: tuple[int, int, int]) -> list[Dots]:
    """Return a tower of four edges and rings between them, to show parallel lines."""
    x, z = ground
    corners = [(x + a * 0.35, z + b * 0.35) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    dots = [line((a, 1, b), (a, -1.5, b), 0.05, color) for a, b in corners]
    for y in np.linspace(1, -1.5, 6):
        for (a, b), (c, d) in zip(corners, corners[1:] + corners[:1], strict=True):
            dots.append(line((a, y, b), (c, y, d), 0.04, color))
    return dots

"""Test inputs of pictures: synthetic photographs, their cameras, and their intrinsics.

Networks that were trained on photographs amplify noise. These pictures have the spectrum of
photographs (amplitude falls with frequency), and are computed by a formula.
"""

__all__ = [
    "CHANNEL_GRADIENTS",
    "intrinsics_of_pictures",
    "synthetic_pictures",
    "test_patterns",
    "views_of_pictures",
]

from collections.abc import Callable

import numpy as np

from gsgen.contract._array_types import Float

# Name of the picture whose channels differ, so that a turned or an exchanged one is another picture.
CHANNEL_GRADIENTS = "a gradient in each channel"

# Waves of a picture: each octave has twice the frequency of the one before, and half its amplitude.
_OCTAVES = 6
_FIRST_AMPLITUDE = 0.25  # all octaves add up to less than twice as much: values stay in [0, 1]


# The annotation of a generator is quoted: NumPy loads its random module when it is named.
def synthetic_pictures(
    shape: tuple[int, ...], rng: "np.random.Generator"
) -> Float[np.ndarray, "v c h w"]:
    """Return pictures with values in [0, 1]: sums of plane waves of random directions and phases.

    Args:
        shape: Number of pictures and channels, height and width; another rank gives random numbers.
        rng: The source of directions and phases.
    """
    if len(shape) != 4:
        return np.asarray(rng.random(shape))
    count, channels, height, width = shape
    directions = rng.uniform(0, 2 * np.pi, (count, _OCTAVES))
    phases = rng.uniform(0, 2 * np.pi, (count, _OCTAVES, channels))
    y, x = np.meshgrid(
        (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij"
    )
    pictures = np.full(shape, 0.5)
    for picture, angles, offsets in zip(pictures, directions, phases, strict=True):
        for octave, (angle, offset) in enumerate(zip(angles, offsets, strict=True)):
            path = 2 * np.pi * 2**octave * (x * np.cos(angle) + y * np.sin(angle))
            wave = np.cos(path[None] + offset[:, None, None])
            picture += _FIRST_AMPLITUDE * 0.5**octave * wave
    return pictures


def test_patterns(shape: tuple[int, ...]) -> dict[str, Float[np.ndarray, "v c h w"]]:
    """Return pictures with values in [0, 1] that formulas give, by their names.

    Args:
        shape: Number of pictures and channels, height and width.
    """
    height, width = shape[-2:]
    y, x = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    patterns = {
        "a black picture": np.zeros((height, width)),
        "a white picture": np.ones((height, width)),
        "a chequerboard": ((x // 4 + y // 4) % 2).astype(np.float64),
        "a gradient": (x + y) / max(width + height - 2, 1),
        CHANNEL_GRADIENTS: _channel_gradients(shape[1], height, width),
    }
    return {name: np.broadcast_to(pattern, shape).copy() for name, pattern in patterns.items()}


def _channel_gradients(channels: int, height: int, width: int) -> Float[np.ndarray, "c h w"]:
    """Return red that grows to the right, green that grows downwards, and a diagonal wave in blue.

    A fourth channel is 1, as opaque alpha is.
    """
    y, x = np.meshgrid(np.linspace(0, 1, height), np.linspace(0, 1, width), indexing="ij")
    wave = 0.5 + 0.5 * np.cos(2 * np.pi * (x + y))
    gradients = (x, y, wave, np.ones_like(x))
    return np.stack([gradients[channel % len(gradients)] for channel in range(channels)])


def views_of_pictures(
    count: int, range_fraction: float, camera: Callable[[float], Float[np.ndarray, "4 4"]]
) -> Float[np.ndarray, "v 4 4"]:
    """Return a world→camera matrix for each picture, evenly spread over the path of test cameras.

    Args:
        count: Number of pictures.
        range_fraction: Place of the first camera on the path, from 0 to 1; the path is closed.
        camera: Returns the view matrix at a place of the path.
    """
    places = [(range_fraction + index / count) % 1 for index in range(count)]
    return np.stack([camera(place) for place in places])


def intrinsics_of_pictures(
    count: int, size: tuple[int, int], field_of_view: float
) -> Float[np.ndarray, "v 3 3"]:
    """Return the same pinhole matrix for each picture, with its principal point in the middle.

    Args:
        count: Number of pictures.
        size: Height and width, in pixels.
        field_of_view: Horizontal, in radians.
    """
    height, width = size
    focal = width / (2 * np.tan(field_of_view / 2))
    matrix = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return np.repeat(matrix[None], count, axis=0)

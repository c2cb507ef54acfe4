"""PSNR of baked files against the generator's own renders at the same cameras."""

__all__ = ["generator_images", "psnr_of_file", "renderer_or_none"]

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float32

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.sources.source import GeneratorSource, Source, StillSource

if TYPE_CHECKING:
    from gsgen.runtime.renderer.renderer import Renderer

Images = list[Float32[np.ndarray, "h w 3"]]


def renderer_or_none() -> "tuple[Renderer | None, str]":
    """Return a renderer, or None and the reason why nothing can be drawn here."""
    try:
        from gsgen.runtime.renderer.renderer import Renderer

        return Renderer(), ""
    except ImportError as error:
        return None, f"{error.name} is not installed: pip install 'gsgen[runtime]'"
    except DeviceUnavailable as error:
        return None, error.message


def generator_images(
    source: GeneratorSource,
    cameras: Sequence[Camera],
    values: Mapping[str, object],
    number: int,
    renderer: "Renderer",
) -> Images:
    """Render a frame of the generator, which is run for each camera.

    Args:
        source: The generator.
        cameras: The cameras.
        values: Values of its other inputs.
        number: Number of the frame, for errors.
        renderer: Draws the images.
    """
    images = []
    for camera in cameras:
        source.update(camera, values, number)
        images.append(_image(source, camera, source.antialias, renderer))
    return images


def psnr_of_file(
    path: Path,
    cameras: Sequence[Camera],
    expected: Images,
    antialias: Literal["classic", "mip"],
    color_space: Literal["srgb", "linear"],
    renderer: "Renderer",
) -> float:
    """Return the peak signal-to-noise ratio of a splat file's renders, in dB; the peak is 1.

    Args:
        path: The splat file.
        cameras: The cameras of ``expected``.
        expected: The generator's own images.
        antialias: Antialiasing of the generator: many formats do not store it.
        color_space: Colour space of the generator: many formats do not store it.
        renderer: Draws the images.

    Returns:
        The ratio over all pixels of all images; infinity if they are equal.
    """
    source = StillSource(path)
    source.color_space = color_space
    images = [_image(source, camera, antialias, renderer) for camera in cameras]
    squares = [np.square(a.astype(np.float64) - b) for a, b in zip(images, expected, strict=True)]
    error = float(np.mean(squares))
    return float(-10 * np.log10(error)) if error > 0 else float("inf")


def _image(
    source: Source, camera: Camera, antialias: Literal["classic", "mip"], renderer: "Renderer"
) -> Float32[np.ndarray, "h w 3"]:
    from gsgen.runtime.scene.scene import Scene

    scene = Scene([source.splats(None, antialias)], color_space=source.color_space)
    rgba = renderer.render(scene, camera, background=(0, 0, 0, 1)).rgba
    assert rgba is not None  # colours are rendered by default
    return np.asarray(np.clip(rgba[..., :3], 0, 1))

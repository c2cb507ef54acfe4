"""Measures the PSNR of baked splat files against pictures that the ONNX generator draws."""

__all__ = ["generator_images", "psnr_of_file", "renderer_or_none"]

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float32

from gsgen.runtime.errors import DeviceUnavailable
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.sources.source import GeneratorSource, Source, StillFrameSource

if TYPE_CHECKING:
    from gsgen.runtime.renderer.renderer import Renderer

Images = list[Float32[np.ndarray, "h w 3"]]


def renderer_or_none() -> "tuple[Renderer | None, str]":
    """Return a renderer, or None and the reason why none can be opened."""
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
    """Run an ONNX generator once per camera with given inputs, and draw its Gaussians."""
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
    """Return the PSNR of a splat file's pictures against expected ones, in dB; the peak is 1.

    Antialiasing and colour space are the generator's, as many formats do not store them. The ratio
    is over all pixels of all cameras, and infinite if the pictures are equal.
    """
    source = StillFrameSource(path)
    source.color_space = color_space
    images = [_image(source, camera, antialias, renderer) for camera in cameras]
    return psnr(np.array(images), np.array(expected))


def _image(
    source: Source, camera: Camera, antialias: Literal["classic", "mip"], renderer: "Renderer"
) -> Float32[np.ndarray, "h w 3"]:
    from gsgen.runtime.scene.scene import Scene

    scene = Scene([source.splats(None, antialias)], color_space=source.color_space)
    rgba = renderer.render(scene, camera, background=(0, 0, 0, 1)).rgba
    assert rgba is not None  # colours are rendered by default
    return np.asarray(np.clip(rgba[..., :3], 0, 1))

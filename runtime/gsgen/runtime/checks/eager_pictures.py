"""Draws frames of an eager torch module, as reference images of its export."""

__all__ = ["draw_source_frames"]

import hashlib
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Final

import numpy as np

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest, ReferenceImage
from gsgen.runtime.errors import DeviceUnavailable

# Least decibels of an exported model beside the eager module, float16 outputs included.
_MIN_PSNR: Final = 40.0


def draw_source_frames(
    manifest: GeneratorManifest, frames: Sequence[tuple[Probe, Mapping[str, np.ndarray]]]
) -> list[tuple[bytes, ReferenceImage]]:
    """Draw a torch module's outputs for some test inputs; return PNGs with manifest entries.

    Args:
        manifest: Declares outputs, conventions and bounds.
        frames: The probe of each picture, and the outputs by name.

    Raises:
        DeviceUnavailable: No graphics device can be opened, or a package is missing.
        SceneInvalid: The outputs cannot be drawn.
    """
    for package in ("wgpu", "PIL"):
        if find_spec(package) is None:
            hint = "pip install 'gsgen[runtime]'"
            raise DeviceUnavailable(f"{package} is not installed", hint=hint)
    from gsgen.runtime.checks.level import probe_camera, scene_of
    from gsgen.runtime.checks.reference_image import BACKGROUND
    from gsgen.runtime.media.pictures import png_of
    from gsgen.runtime.renderer.renderer import Renderer

    renderer = Renderer(rasteriser="tiles")
    pictures = []
    for probe, outputs in frames:
        camera = probe_camera(manifest, probe)
        frame = renderer.render(scene_of(manifest, outputs), camera, background=BACKGROUND)
        png = png_of(frame.srgb8[..., :3])
        rows = [tuple(float(value) for value in row) for row in camera.view[:3]]
        declaration = ReferenceImage(
            path="picture.png",  # the exporter names it
            sha256=hashlib.sha256(png).hexdigest(),
            inputs=probe.label,
            view=tuple(rows),  # type: ignore[arg-type]  # four numbers each
            focal=(camera.fx, camera.fy),
            center=(camera.cx, camera.cy),
            psnr=_MIN_PSNR,
            from_="source",
        )
        pictures.append((png, declaration))
    return pictures

"""Draws the expected pictures of a viewer test kit."""

__all__ = ["draw_frames", "on_screen", "runtime_camera"]

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gsgen.conformance.viewer_kit.case import KitCamera, KitFrame
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.srgb import srgb_of_linear
from gsgen.runtime.checks.level import scene_of
from gsgen.runtime.oracle.render import render
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from gsgen.sdk.binding import FrameSession


def draw_frames(model: Path, frames: Sequence[KitFrame]) -> list[Float[np.ndarray, "h w 3"]]:
    """Run an ONNX generator frame by frame, and draw its frames with the float64 renderer."""
    pictures = []
    with FrameSession(model, provider="cpu") as session:
        manifest = session.manifest
        assert isinstance(manifest, GeneratorManifest)
        for frame in frames:
            camera = runtime_camera(frame.camera)
            outputs = session.run(frame.values, camera=camera, copy=True)
            scene = scene_of(manifest, {name: outputs[name] for name in outputs})
            pictures.append(on_screen(render(scene, camera).rgba, scene))
    return pictures


def runtime_camera(camera: KitCamera) -> Camera:
    """Convert a camera of the viewer test kit to a camera of the renderer."""
    return Camera(**{field.name: getattr(camera, field.name) for field in fields(camera)})


def on_screen(rgba: Float[np.ndarray, "h w 4"], scene: Scene) -> Float[np.ndarray, "h w 3"]:
    """Return the image over black that a screen shows: colours clamped to [0, 1], sRGB-encoded."""
    color = np.clip(rgba[..., :3], 0, 1)
    return srgb_of_linear(color) if scene.color_space == "linear" else color

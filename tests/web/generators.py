"""Frames of generators that a page draws, beside what Python computes and draws."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.conformance.viewer_kit.case import KitFrame
from gsgen.contract.spec.srgb import srgb_of_linear
from gsgen.runtime.checks.viewer_kit import draw_frames, runtime_camera
from support.web.pages import WebSite, unpacked
from support.web.scenes import camera_of


def drawn_frames(site: WebSite, path: Path, frames: Sequence[KitFrame]) -> Any:
    """Draw frames of a model one after the other in one session of a page."""
    site.contents[f"/{path.name}"] = path.read_bytes()
    return site.call("generatorFrames", f"/{path.name}", described_frames(frames))


def described_frames(frames: Sequence[KitFrame]) -> list[dict[str, Any]]:
    """Return the camera and the values of each frame, as JavaScript takes them."""
    return [
        {
            "camera": camera_of(runtime_camera(frame.camera)),
            "values": {name: value.ravel().tolist() for name, value in frame.values.items()},
        }
        for frame in frames
    ]


def assert_same_pictures(
    result: Any, path: Path, frames: Sequence[KitFrame], tolerance: float
) -> None:
    """Compare the pictures of :func:`drawn_frames` with those of the float64 renderer."""
    assert "error" not in result, result["error"]
    assert result["errors"] == []
    for text, expected, frame in zip(
        result["images"], draw_frames(path, frames), frames, strict=True
    ):
        shape = (frame.camera.height, frame.camera.width, 4)
        color = np.clip(unpacked(text, np.float32).reshape(shape)[..., :3], 0, 1)
        actual = srgb_of_linear(color) if result["isLinear"] else color
        np.testing.assert_allclose(actual, expected, atol=tolerance)

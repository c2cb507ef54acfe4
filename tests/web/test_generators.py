"""Generators in a page, by ONNX Runtime Web: every case of the viewer kit, in one session each."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.viewer_kit.case import KitCase
from gsgen.conformance.viewer_kit.write import kit_cases
from gsgen.runtime.checks.viewer_kit import draw_frames, runtime_camera
from gsgen.runtime.scene.frame import srgb_of_linear
from gsgen.runtime.web.onnxruntime_web import ORT_FILES, cached_ort
from support.web.pages import WebSite, unpacked
from support.web.scenes import camera_of

_TOLERANCE = 1e-4  # SwiftShader's trigonometry; sums alone are good to 5e-6
_NOT_SHOWN = {"external-data": "refuses the model", "weighted-sum": "is drawn by weighted sums"}
"""Cases that pages do not draw yet, with a part of their error."""

_UNCAPTURED: set[str] = set()
"""Cases whose outputs come from buffer copies."""


@pytest.fixture(autouse=True)
def ort(site: WebSite) -> None:
    """Serve ONNX Runtime Web beside the client, as pages have it."""
    folder = cached_ort()
    if not all((folder / name).is_file() for name in ORT_FILES):
        message = f"missing: ONNX Runtime Web in {folder}; hint: make ort"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    for name in ORT_FILES:
        path = f"/client/ort/{name}"
        if path not in site.contents:
            site.contents[path] = (folder / name).read_bytes()


def frames_of(case: KitCase) -> list[dict[str, Any]]:
    return [
        {
            "camera": camera_of(runtime_camera(frame.camera)),
            "values": {name: value.ravel().tolist() for name, value in frame.values.items()},
        }
        for frame in case.frames
    ]


def result_of(site: WebSite, case: KitCase, path: Path) -> Any:
    case.spec().write(path)
    site.contents[f"/{path.name}"] = path.read_bytes()
    return site.call("generatorFrames", f"/{path.name}", frames_of(case))


@pytest.mark.parametrize("case", kit_cases(), ids=lambda case: case.name)
def test_a_page_draws_the_viewer_kit(case: KitCase, site: WebSite, tmp_path: Path) -> None:
    path = tmp_path / f"{case.name}.onnx"
    result = result_of(site, case, path)
    if case.name in _NOT_SHOWN:
        assert _NOT_SHOWN[case.name] in result["error"]
        return
    assert "error" not in result, result["error"]
    assert result["errors"] == []
    has_inputs = any(frame.values for frame in case.frames) or "camera" in case.name
    if has_inputs and case.name not in {"camera-lens"}:
        assert result["isCaptured"] is (case.name not in _UNCAPTURED)
    for text, expected, frame in zip(
        result["images"], draw_frames(path, case.frames), case.frames, strict=True
    ):
        shape = (frame.camera.height, frame.camera.width, 4)
        color = np.clip(unpacked(text, np.float32).reshape(shape)[..., :3], 0, 1)
        actual = srgb_of_linear(color) if result["isLinear"] else color
        np.testing.assert_allclose(actual, expected, atol=_TOLERANCE)

"""Generators in a page, by ONNX Runtime Web: every case of the viewer kit, in one session each."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.viewer_kit.case import ViewerKitCase
from gsgen.conformance.viewer_kit.write import kit_cases
from support.web.pages import WebSite
from web.generators import assert_same_pictures, described_frames, drawn_frames

_TOLERANCE = 1e-4  # SwiftShader's trigonometry; sums alone are good to 5e-6
_UNSUPPORTED_MODELS = {"external-data": "refuses the model"}
"""Cases that pages do not draw yet, with a part of their error."""

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ort")]


@pytest.mark.parametrize("case", kit_cases(), ids=lambda case: case.name)
def test_a_page_draws_the_viewer_kit(case: ViewerKitCase, site: WebSite, tmp_path: Path) -> None:
    path = tmp_path / f"{case.name}.onnx"
    case.spec().write(path)
    result = drawn_frames(site, path, case.frames)
    if case.name in _UNSUPPORTED_MODELS:
        assert _UNSUPPORTED_MODELS[case.name] in result["error"]
        return
    assert_same_pictures(result, path, case.frames, _TOLERANCE)
    has_inputs = any(frame.values for frame in case.frames) or "camera" in case.name
    if has_inputs and case.name not in {"camera-lens"}:
        assert result["isCaptured"]


def test_generators_of_a_page_are_opened_at_the_same_time(site: WebSite, tmp_path: Path) -> None:
    """ONNX Runtime refuses a session while it creates another: one waits for the other."""
    case = next(case for case in kit_cases() if any(frame.values for frame in case.frames))
    path = tmp_path / "twice.onnx"
    case.spec().write(path)
    site.contents["/twice.onnx"] = path.read_bytes()
    result = site.call("openTwice", "/twice.onnx", described_frames(case.frames)[-1])
    assert result["errors"] == []
    first, second = result["extents"]
    assert first == second


def test_a_model_in_float16_says_that_the_device_lacks_it(site: WebSite, tmp_path: Path) -> None:
    """The browser's software device has no `shader-f16`; weights alone are widened by the CPU."""
    frames = kit_cases()[0].frames[:1]
    result = drawn_frames(site, find("drift_half").write(tmp_path), frames)
    assert result["error"] == (
        "/drift_half.onnx: computes in float16, which this graphics device does not"
        " | Export it with --dtype float32."
    )
    assert drawn_frames(site, find("still_half_sh1").write(tmp_path), frames).get("extent")

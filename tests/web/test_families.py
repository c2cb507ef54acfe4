"""Six frames of every family of generators in a page, beside Python's."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.sdk.binding import FrameSession
from support.web.families import FAMILIES, export_family, family_frames, plugin_names
from support.web.generators import assert_same_pictures, drawn_frames
from support.web.pages import WebSite, unpacked

pytestmark = pytest.mark.usefixtures("ort")


def test_no_family_is_forgotten() -> None:
    assert set(FAMILIES) == plugin_names()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_page_draws_six_frames_of_a_family(name: str, site: WebSite, tmp_path: Path) -> None:
    path = export_family(name, tmp_path)
    frames, tolerance = family_frames(path), FAMILIES[name].tolerance
    result = drawn_frames(site, path, frames)
    assert "error" not in result, result["error"]
    assert result["isCaptured"]
    with FrameSession(path, provider="cpu") as session:
        for text, frame in zip(result["rows"], frames, strict=True):
            outputs = session.run(frame.values, camera=frame.camera, copy=True)
            expected = outputs["gaussians"]
            actual = unpacked(text, np.float32).reshape(expected.shape)
            error = np.abs(actual - expected) / np.abs(expected).max(axis=0)
            assert error.max() <= tolerance
    assert_same_pictures(result, path, frames, 5 * tolerance)

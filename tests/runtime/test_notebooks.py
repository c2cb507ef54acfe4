"""Frames, scenes, splats and reports show themselves in notebooks, and stay in saved ones."""

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.contract import _notebook, validate
from gsgen.formats import Splats
from gsgen.reference_plugins.samples import garden
from gsgen.runtime import Camera, Renderer, Scene, SplatData


def embedded(html: str) -> np.ndarray:
    """Return the only picture of an HTML text, which must refer to no file."""
    assert "http" not in html
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_splats_show_a_picture_and_facts() -> None:
    html = garden(3000)._repr_html_()
    assert "splats</strong>" in html
    assert "SH degree" in html
    picture = embedded(html)
    assert picture.shape == (320, 480, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500  # of a garden, not of a backdrop


def test_a_scene_shows_all_its_sets() -> None:
    scene = Scene([SplatData.from_splats(garden(3000))] * 2)
    html = scene._repr_html_()
    assert "in 2 sets" in html
    assert embedded(html).std() > 20


def test_a_frame_is_a_png_of_its_bytes() -> None:
    camera = Camera.orbit((0, -1, 0), 6, width=48, height=32)
    frame = Renderer().render(Scene([SplatData.from_splats(garden(3000))]), camera)
    png = frame._repr_png_()
    assert png is not None
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(png))), frame.srgb8)
    assert repr(frame) == f"<Frame: 48×32 pixels, rgba, {frame.visible:,} visible Gaussians>"


def test_a_frame_without_colours_shows_nothing() -> None:
    camera = Camera.orbit((0, -1, 0), 6, width=48, height=32)
    scene = Scene([SplatData.from_splats(garden(3000))])
    assert Renderer().render(scene, camera, outputs=("depth",))._repr_png_() is None


def test_no_splats_are_a_table_without_a_box_of_nothing() -> None:
    none = np.zeros((0, 3), np.float32)
    empty = Splats(
        position=none,
        rotation=np.zeros((0, 4), np.float32),
        log_scale=none,
        logit_opacity=np.zeros(0, np.float32),
        sh=np.zeros((0, 1, 3), np.float32),
    )
    assert "<strong>0 splats</strong>" in empty._repr_html_()


def test_notebook_report_names_its_findings(tmp_path: Path) -> None:
    report = validate(find("opacity_is_logits").write(tmp_path))
    html = report._repr_html_()
    assert "opacity_is_logits.onnx: invalid" in html
    assert "GV003 error" in html


def test_texts_are_escaped() -> None:
    html = _notebook.summary_html("<script>", [("<b>", "&")])
    assert "<script>" not in html
    assert "&lt;b&gt;" in html
    assert "&amp;" in html


def test_without_a_renderer_the_table_remains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_notebook, "_renderers", [])
    html = garden(300)._repr_html_()
    assert "<table>" in html
    assert "<img" not in html

"""Every family of generators in one page that opens from disk: six frames, beside Python's."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.sdk.binding import FrameSession
from support.commands import gsgen_here
from support.web.pages import unpacked
from web.families import FAMILIES, export_family, family_frames, plugin_names
from web.generators import assert_same_pictures, described_frames

pytestmark = pytest.mark.slow


_SCRIPT = (Path(__file__).parents[1] / "support/web/element_frames.js").read_text("utf-8")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("families")
    return {name: export_family(name, folder) for name in FAMILIES}


@pytest.fixture(scope="module")
def page(browser: Any, models: dict[str, Path], ort_folder: Path) -> Iterator[Any]:
    """The page that `gsgen export html` writes of all families, opened from disk."""
    file = next(iter(models.values())).with_name("families.html")
    words = (*models.values(), "-o", file, "--time", "0", "--ort", ort_folder)
    assert gsgen_here("export", "html", *words).code == 0
    context = browser.new_context(viewport={"width": 320, "height": 200})
    page = context.new_page()
    page.set_default_timeout(180_000)
    page.goto(file.as_uri())
    yield page
    context.close()


def test_no_family_is_forgotten() -> None:
    assert set(FAMILIES) == plugin_names()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_page_draws_six_frames_of_a_family(name: str, page: Any, models: dict[str, Path]) -> None:
    path = models[name]
    frames, tolerance = family_frames(path), FAMILIES[name].tolerance
    result = page.evaluate(_SCRIPT, [path.name, described_frames(frames)])
    assert_same_pictures(result, path, frames, 5 * tolerance)
    assert result["isCaptured"]
    with FrameSession(path, provider="cpu") as session:
        for text, frame in zip(result["rows"], frames, strict=True):
            expected = session.run(frame.values, camera=frame.camera, copy=True)["gaussians"]
            actual = unpacked(text, np.float32).reshape(expected.shape)
            error = np.abs(actual - expected) / np.abs(expected).max(axis=0)
            assert error.max() <= tolerance

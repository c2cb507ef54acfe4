"""The pictures of conventions are what the renderer draws today."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from support.commands import ROOT
from support.reports.pages import DOCS

PAGE = DOCS / "guides" / "coordinate-systems-and-cameras.md"
MOST_BYTES = 60_000


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("pictures")
    script = ROOT / "scripts" / "draw_conventions.py"
    subprocess.run([sys.executable, script, folder], check=True, timeout=300)
    return sorted(folder.iterdir())


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"), float)


def test_pictures_are_current(drawn: list[Path]) -> None:
    for path in drawn:
        kept = DOCS / "assets" / path.name
        new, old = pixels(path), pixels(kept)
        assert new.shape == old.shape, path.name
        difference = np.abs(new - old).mean()  # drivers differ by a little, palettes by more
        assert difference < 0.5, f"{path.name}: run scripts/draw_conventions.py"
        assert kept.stat().st_size <= MOST_BYTES


def test_the_page_shows_them_all(drawn: list[Path]) -> None:
    text = PAGE.read_text("utf-8")
    assert len(drawn) >= 8
    for path in drawn:
        assert f"](../assets/{path.name})" in text

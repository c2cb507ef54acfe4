"""Pages hold positions relative to a point: a given one, or one that map coordinates need."""

import base64
import re
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import read_ply, write_ply, write_spz
from support.commands import gsgen_here
from support.far_scenes import far_splats, write_double_ply
from support.splat_files import scene


def positions_in_page(folder: Path, *words: object) -> np.ndarray:
    """The positions of the one model of a page, in the page's coordinates."""
    completed = gsgen_here("export", "html", *words, "-o", folder / "page.html")
    assert completed.code == 0, completed.err
    text = (folder / "page.html").read_text("utf-8")
    match = re.search(r'<script type="text/plain" id="model-0">([^<]*)</script>', text)
    assert match is not None
    (folder / "model.ply").write_bytes(base64.b64decode(match[1]))
    return read_ply(folder / "model.ply").position


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_page_with_an_origin_holds_positions_relative_to_it(tmp_path: Path, suffix: str) -> None:
    splats = scene(20, 1)
    path = tmp_path / f"a{suffix}"
    (write_ply if suffix == ".ply" else write_spz)(path, splats)
    positions = positions_in_page(tmp_path, path, "--origin", "1,-2,3")
    np.testing.assert_allclose(positions, splats.position - [1, -2, 3], atol=1e-3)


def test_page_of_map_coordinates_keeps_their_digits(tmp_path: Path) -> None:
    splats = far_splats((448000.0, 5412000.0, 1000.0))
    path = write_double_ply(tmp_path, splats)
    np.testing.assert_allclose(positions_in_page(tmp_path, path), splats.position, atol=1e-6)
    moved = positions_in_page(tmp_path, path, "--origin", "448010,5412000,1000")
    np.testing.assert_allclose(moved, splats.position - [10, 0, 0], atol=1e-5)


@pytest.mark.parametrize("words", [("export", "html"), ("view", "--web")])
def test_wrong_origin_of_a_page_is_refused(tmp_path: Path, words: tuple[str, ...]) -> None:
    write_ply(tmp_path / "a.ply", scene(4, 0))
    output = ("-o", tmp_path / "a.html") if words[0] == "export" else ()
    completed = gsgen_here(*words, tmp_path / "a.ply", "--origin", "1,x", *output)
    assert completed.code == 2
    assert "--origin" in completed.err

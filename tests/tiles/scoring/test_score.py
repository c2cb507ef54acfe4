"""`gsgen tiles score`: levels against the scene, drawn by the project's own renderer."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import write_ply
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.scoring.score import CAMERA_DISTANCES, level_cut
from gsgen.tiles.validation.sketches import explicit_sketch, implicit_sketch
from support.commands import gsgen_here


@pytest.mark.parametrize("make", [explicit_sketch, implicit_sketch])
def test_cut_sizes_match_handwritten_counts(tmp_path: Path, make) -> None:
    make().write(tmp_path / "tileset.json")
    tileset = open_tileset(tmp_path)
    cuts = [[tile.level for tile, _ in level_cut(tileset.root, level)] for level in range(5)]
    if make is explicit_sketch:
        assert cuts == [[0], [1, 1], [1, 1], [1, 1], [1, 1]]
    else:  # the first level of the tree hangs below a root without content
        assert [len(cut) for cut in cuts] == [1, 3, 4, 4, 4]
        assert [set(cut) for cut in cuts] == [{1}, {2}, {3}, {3}, {3}]


def test_all_leaves_look_like_the_scene_and_the_root_does_less(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    explicit_sketch().write(folder / "tileset.json")
    scene, picture = tmp_path / "scene.ply", tmp_path / "out" / "levels.png"
    write_ply(scene, read_leaves(folder))
    words = ("tiles", "score", folder, scene, "-o", picture, "--width", "96", "--height", "64")
    completed = gsgen_here(*words, "--json")
    assert completed.code == 0, completed.err
    document = json.loads(completed.out)
    root, leaves = document["levels"]
    assert (root["tiles"], root["splats"]) == (1, 16)
    assert (leaves["tiles"], leaves["splats"]) == (2, 48)
    assert leaves["bytes"] == sum(file.stat().st_size for file in (folder / "t/1").iterdir())
    for distance in CAMERA_DISTANCES:
        assert leaves["ssim"][distance] > 0.99999
        assert root["ssim"][distance] < leaves["ssim"][distance]
    sheet = np.asarray(Image.open(picture))
    columns, rows = 3, len(CAMERA_DISTANCES)
    assert sheet.shape[0] > rows * 64
    assert sheet.shape[1] > columns * 96
    assert np.ptp(sheet) > 100
    table = gsgen_here(*words).out
    assert table.splitlines()[1].split()[:3] == ["1", "2", "48"]


def test_a_scene_that_is_missing_ends_with_four(tmp_path: Path) -> None:
    explicit_sketch().write(tmp_path / "tileset.json")
    completed = gsgen_here("tiles", "score", tmp_path, tmp_path / "none.ply")
    assert completed.code == 4
    assert "none.ply" in completed.err
    assert "Traceback" not in completed.err
    assert not (tmp_path / "score.png").exists()

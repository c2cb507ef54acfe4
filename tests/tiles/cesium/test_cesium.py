"""Tilesets in CesiumJS, in a headless browser: every tile loads, and the scene stands upright."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import label

from gsgen.formats import Splats
from gsgen.tiles.validation import sketches
from support.tiles.foreign_tiles import east_north_up, write
from tiles.cesium import first_draft
from tiles.cesium.viewer import Viewer, opened_viewer

pytestmark = pytest.mark.slow


_SPLATS_PER_BLOCK = 1500


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    """One page for all tests: to load CesiumJS takes as long as to show a tileset."""
    with opened_viewer() as viewer:
        yield viewer


def signpost(
    rows: int, center: tuple[float, float, float], *, degree: int = 1, seed: int = 0
) -> Splats:
    """Green ground, a red tower up (+z), and a blue arrow to the east (+x)."""
    rng = np.random.default_rng(seed)
    ground_points = np.column_stack(
        [rng.uniform(-1.8, 1.8, (_SPLATS_PER_BLOCK, 2)), rng.normal(-1.5, 0.02, _SPLATS_PER_BLOCK)]
    )
    tower = np.column_stack(
        [rng.normal(0, 0.15, (_SPLATS_PER_BLOCK, 2)), rng.uniform(-1.4, 1.6, _SPLATS_PER_BLOCK)]
    )
    arrow = np.column_stack(
        [
            rng.uniform(0.2, 1.8, _SPLATS_PER_BLOCK),
            rng.normal([0, -1.3], 0.06, (_SPLATS_PER_BLOCK, 2)),
        ]
    )
    colors = np.repeat(
        [[0.1, 0.8, 0.1], [0.9, 0.1, 0.1], [0.1, 0.2, 1.0]], _SPLATS_PER_BLOCK, axis=0
    )
    count = 3 * _SPLATS_PER_BLOCK
    sh = np.zeros((count, (degree + 1) ** 2, 3))
    sh[:, 0] = (colors - 0.5) / 0.28209479
    return Splats(
        position=(np.vstack([ground_points, tower, arrow]) + center).astype(np.float32),
        rotation=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        log_scale=np.full((count, 3), -3.2, np.float32),
        logit_opacity=np.full(count, 3.0, np.float32),
        sh=sh.astype(np.float32),
    )


@pytest.mark.parametrize("kind", ["explicit", "implicit"])
def test_every_tile_loads_and_the_scene_stands_upright(
    kind: str, viewer: Viewer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sketches, "sample_splats", signpost)
    globe = east_north_up(2.2945, 48.8584, 35.0)
    if kind == "explicit":
        spec = sketches.explicit_sketch(transform=globe)
        tiles, leaves = 3, 2
    else:
        spec = sketches.implicit_sketch()
        spec.document["root"]["transform"] = globe.T.ravel().tolist()
        tiles, leaves = 8, 4
    spec.write(tmp_path / "tileset.json")
    view_report = viewer.view(tmp_path)
    assert (view_report.failed, view_report.errors) == ([], [])
    files = {name for name in view_report.loaded if name.endswith(".glb")}
    assert files == {name for name in spec.files if name.endswith(".glb")}
    assert len(files) == tiles
    assert view_report.splats == leaves * 3 * _SPLATS_PER_BLOCK
    Image.fromarray(view_report.picture).save(tmp_path / "seen.png")
    red, green, blue = np.moveaxis(view_report.picture.astype(int), 2, 0)
    towers = (red > 120) & (green < 90) & (blue < 90)
    is_ground_pixel = (green > 120) & (red < 90) & (blue < 90)
    arrows = (blue > 120) & (red < 90) & (green < 120)
    assert min(towers.sum(), is_ground_pixel.sum(), arrows.sum()) > 20
    assert np.nonzero(towers)[0].mean() < np.nonzero(is_ground_pixel)[0].mean() - 3


def test_viewer_reports_a_tile_that_does_not_load(viewer: Viewer, tmp_path: Path) -> None:
    """The test above would notice a tile that does not load."""
    spec = sketches.explicit_sketch(transform=east_north_up(2.2945, 48.8584, 35.0), record=False)
    spec.write(tmp_path / "tileset.json")
    name = spec.document["root"]["children"][0]["content"]["uri"]
    (tmp_path / name).unlink()
    view_report = viewer.view(tmp_path)
    assert [url for url in view_report.failed if name in url]


def test_the_first_draft_is_drawn_as_points(viewer: Viewer, tmp_path: Path) -> None:
    """GT007 is right: without the required extensions, five splats are five dots."""
    write(tmp_path, first_draft.five_splats())
    view_report = viewer.view(tmp_path)
    assert (view_report.failed, view_report.errors, view_report.splats) == ([], [], 0)
    assert view_report.loaded == ["0/0.gltf"]
    _, dots = label(view_report.picture.max(axis=2) > 20, structure=np.ones((3, 3)))
    assert dots == 5

"""A streamed SOG is a tileset: its leaves are chains of tiles, by error and level."""

import json
import math
from pathlib import Path

import pytest

from gsgen.formats import write_sog
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.loading.leaves import finest_contents, read_contents
from gsgen.tiles.loading.streamed_sog import SogFiles
from gsgen.tiles.loading.tileset_loader import Limits, load_tileset, open_tileset
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.stores.folder_store import FolderStore
from support.splat_files import GOLDENS, scene

BOUND = {"min": [0, 0, 0], "max": [3, 4, 12]}  # a diagonal of 13


@pytest.fixture
def tree(tmp_path: Path) -> dict:
    """Two leaves, of which one lacks a level, in two files, and an environment."""
    for number, name in enumerate(("0_0", "1_0", "env")):
        (tmp_path / name).mkdir()
        write_sog(tmp_path / name / "meta.json", scene(20, 1, seed=number))
    rows = [{"file": 0, "offset": 0, "count": 20}, {"file": 1, "offset": 8, "count": 9}]
    both = {"bound": BOUND, "errors": [0, 0.25], "lods": {"0": rows[0], "1": rows[1]}}
    coarse = {"bound": BOUND, "lods": {"1": {"file": 1, "offset": 0, "count": 4}}}
    return {
        "lodLevels": 2,
        "filenames": ["0_0/meta.json", "1_0/meta.json"],
        "environment": "env/meta.json",
        "tree": {"children": [both, coarse]},
    }


def write(tree: dict, folder: Path) -> Path:
    path = folder / "lod-meta.json"
    path.write_text(json.dumps(tree))
    return path


def test_leaves_are_chains_of_tiles(tree: dict, tmp_path: Path) -> None:
    tileset = open_tileset(write(tree, tmp_path))
    assert tileset.metadata["sh_degree"] == 1
    assert tileset.up == pytest.approx([0, -1, 0])
    first, second = tileset.root.children
    # Errors are relative to the diagonal; of a leaf alone there is none.
    assert first.geometric_error == pytest.approx(13 * 0.5)
    assert [first.children[0].geometric_error, second.geometric_error] == [0, 0]
    # Coarsest levels of all leaves come first.
    assert [first.level, first.children[0].level, second.level] == [1, 2, 1]
    arrays = TileTree.of_tileset(tileset)
    assert arrays.splats[1:].tolist() == [9, 20, 4]
    store = FolderStore(tmp_path)
    placed = read_contents(store, tileset, finest_contents(tileset))
    # The environment, and the finest level of each leaf.
    assert [len(part) for part in placed] == [20, 20, 4]


def test_a_file_of_several_leaves_is_decoded_once(
    tree: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scores count the bytes of its meta.json and of its pictures."""
    tileset, store, sog_files = (
        open_tileset(write(tree, tmp_path)),
        FolderStore(tmp_path),
        SogFiles(),
    )
    decoded: list[str] = []
    read = store.read
    monkeypatch.setattr(
        store, "read", lambda path, **rest: decoded.append(path) or read(path, **rest)
    )
    contents = [(tile, content) for tile in tileset.tiles() for content in tile.contents]
    for _ in range(2):
        placed = read_contents(store, tileset, contents, sog_files)
        assert sorted(len(part) for part in placed) == [4, 9, 20, 20]
    assert len(decoded) == len(set(decoded))
    assert sog_files.sizes == {
        f"{name}/meta.json": sum(file.stat().st_size for file in (tmp_path / name).iterdir())
        for name in ("0_0", "1_0", "env")
    }


def test_without_errors_levels_are_told_apart_by_their_splats(tree: dict, tmp_path: Path) -> None:
    del tree["tree"]["children"][0]["errors"]
    first = open_tileset(write(tree, tmp_path)).root.children[0]
    assert first.geometric_error == pytest.approx(13 * 4 / math.sqrt(9))
    golden = open_tileset(GOLDENS / "streamed" / "lod-meta.json")
    assert golden.root.children[0].geometric_error > 0


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"bound": {}}, "min and max of 3 numbers"),
        ({"bound": {"min": [1, 0, 0], "max": [0, 1, 1]}}, "min of max or less"),
        ({"bound": {"min": [0, 0, 0, 0], "max": [1, 1, 1]}}, "min and max of 3 numbers"),
        ({"errors": [0, "x"]}, "numbers of 0 or more"),
        ({"errors": [0, -1]}, "numbers of 0 or more"),
        ({"lods": {"0": {"file": 7, "offset": 0, "count": 1}}}, "one of 2 files"),
    ],
)
def test_damaged_leaves_are_refused(tree: dict, tmp_path: Path, change: dict, match: str) -> None:
    tree["tree"]["children"][0] |= change
    with pytest.raises(TilesetInvalid, match=match) as caught:
        open_tileset(write(tree, tmp_path))
    assert "lod-meta.json" in str(caught.value)


def test_rows_images_and_limits_are_checked(tree: dict, tmp_path: Path) -> None:
    path, store = write(tree, tmp_path), FolderStore(tmp_path)
    with pytest.raises(TilesetInvalid, match="more than 2 levels of leaves"):
        load_tileset(store, path.name, limits=Limits(tiles=2))
    tree["tree"]["children"][0]["lods"]["0"]["count"] = 21
    tileset = load_tileset(store, write(tree, tmp_path).name)
    tile = tileset.root.children[0].children[0]
    with pytest.raises(TilesetInvalid, match=r"(?s)row 20 of 0_0/meta.json.*rows from 0 to 19"):
        read_contents(store, tileset, [(tile, tile.contents[0])])
    meta = tmp_path / "1_0" / "meta.json"
    meta.write_text(meta.read_text().replace("means_l.webp", "../0_0/means_l.webp"))
    tile = tileset.root.children[0]
    with pytest.raises(TilesetInvalid, match="a file in the same folder"):
        read_contents(store, tileset, [(tile, tile.contents[0])])

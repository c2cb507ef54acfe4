"""The index: boxes hold what is below, implicit and explicit say the same."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.tiles.format.implicit_tiling.writing import implicit_uri, write_implicit_tileset
from gsgen.tiles.format.index import (
    ContentRecord,
    TileRecord,
    box_numbers,
    tileset_document,
    write_document,
)
from gsgen.tiles.format.metadata import TILE_CLASS, implicit_metadata_schema, metadata_schema
from gsgen.tiles.loading.info import describe_tileset
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.validation.sketches import explicit_sketch, implicit_sketch


def corner(*values: float) -> np.ndarray:
    return np.array(values)


def write_tileset(path: Path, root: TileRecord, **facts: object) -> None:
    write_document(path, tileset_document(root, **facts))


def record(level: int, cell: tuple[int, int, int], **changes: object) -> TileRecord:
    base = TileRecord(
        level=level,
        coordinates=cell,
        low=corner(0, 0, 0),
        high=corner(1, 1, 1),
        geometric_error=1.0,
    )
    return replace(base, **changes)  # type: ignore[arg-type]


def test_boxes_grow_with_their_children(tmp_path: Path) -> None:
    content = ContentRecord(uri="a.glb", size=1, low=corner(-3, 0, 0), high=corner(1, 7, 1))
    leaf = record(2, (0, 0, 0), contents=(content,), splats=1, geometric_error=0.0)
    root = record(0, (0, 0, 0), children=(record(1, (0, 0, 0), children=(leaf,)),))
    path = tmp_path / "tileset.json"
    write_tileset(path, root, source_splats=1, sh_degree=0)
    for tile in open_tileset(path).tiles():
        samples = tile.volume.samples()
        assert np.allclose(samples.min(axis=0), [-3, 0, 0])
        assert np.allclose(samples.max(axis=0), [1, 7, 1])


def test_a_quality_names_its_contents(tmp_path: Path) -> None:
    contents = tuple(
        ContentRecord(uri=f"{n}.glb", size=n, low=corner(0, 0, 0), high=corner(1, 1, 1))
        for n in (30, 20)
    )
    root = record(0, (0, 0, 0), contents=contents, splats=1)
    for quality, uri in ((0, "30.glb"), (1, "20.glb"), (4, "20.glb")):
        path = tmp_path / f"tileset-q{quality}.json"
        write_tileset(path, root, source_splats=1, sh_degree=0, quality=quality)
        assert [c.uri for c in open_tileset(path).root.contents] == [uri]
        assert open_tileset(path).root.metadata["bytes"] == [30, 20]
        size = int(uri.removesuffix(".glb"))
        assert describe_tileset(path).bytes == size


def test_the_index_is_sorted_and_always_the_same(tmp_path: Path) -> None:
    path = tmp_path / "tileset.json"
    transform = np.eye(4)
    transform[0, 3] = 1e6 + 1 / 3
    for _ in range(2):
        write_tileset(path, record(0, (0, 0, 0)), source_splats=1, sh_degree=0, transform=transform)
    text = path.read_text()
    assert text == json.dumps(json.loads(text), sort_keys=True, separators=(",", ":")) + "\n"
    assert np.array_equal(open_tileset(path).transform, transform)


def test_an_implicit_octree_says_what_its_records_say(tmp_path: Path) -> None:
    """Boxes and errors of every tile survive the tables; subtrees are two levels each."""
    spec = implicit_sketch()
    path = tmp_path / "tileset.json"
    spec.write(path)
    tileset = open_tileset(path)
    assert tileset.root.contents == ()
    (tree,) = tileset.root.children
    assert {tile.level - 1 for tile in tileset.tiles()} == {-1, 0, 1, 2}
    errors = {tile.level - 1: tile.geometric_error for tile in tileset.tiles()}
    assert errors | {-1: 0} == {-1: 0, 0: 1.0, 1: 0.5, 2: 0.0}
    for tile in [tree, *tree.children]:
        for content in tile.contents:
            assert content.volume is not None
            assert tile.volume.outside(content.volume.samples()).max() < 1e-9
    names = [name for name in spec.files if name.endswith(".subtree")]
    assert len(names) == 1 + 4
    assert len(read_leaves(path)) == 4 * 24


def test_oversized_tiles_stand_beside_the_tree(tmp_path: Path) -> None:
    content_record = ContentRecord(uri="w.glb", size=1, low=corner(-9, 0, 0), high=corner(9, 1, 1))
    oversized_tile = record(0, (0, 0, 0), oversized=True, contents=(content_record,), splats=1)
    tree = ContentRecord(uri="t/0/0_0_0-q0.glb", size=1, low=corner(0, 0, 0), high=corner(1, 1, 1))
    root = record(
        0, (0, 0, 0), contents=(tree,), children=(replace(oversized_tile, geometric_error=0),)
    )
    path = tmp_path / "tileset.json"
    write_implicit_tileset(path, root, source_splats=2, sh_degree=0)
    tileset = open_tileset(path)
    names = [[c.uri for c in tile.contents] for tile in tileset.root.children]
    assert names == [["t/0/0_0_0-q0.glb"], ["w.glb"]]
    assert np.allclose(tileset.root.volume.samples().min(axis=0), [-9, 0, 0])


def test_a_content_elsewhere_than_its_template_is_refused(tmp_path: Path) -> None:
    content = ContentRecord(uri="x.glb", size=1, low=corner(0, 0, 0), high=corner(1, 1, 1))
    root = record(0, (0, 0, 0), contents=(content,))
    with pytest.raises(ValueError, match="0_0_0"):
        write_implicit_tileset(tmp_path / "t.json", root, source_splats=1, sh_degree=0)


def test_box_numbers_are_centre_and_half_axes() -> None:
    numbers = box_numbers(corner(-1, 2, 3), corner(3, 2.5, 9))
    assert numbers == [1, 2.25, 6, 2, 0, 0, 0, 0.25, 0, 0, 0, 3]


def test_the_sketch_has_one_leaf_more_than_levels() -> None:
    assert len(explicit_sketch().document["root"]["children"]) == 2


def test_up_is_a_unit_vector_in_the_root_s_frame(tmp_path: Path) -> None:
    path = tmp_path / "tileset.json"
    write_tileset(path, record(0, (0, 0, 0)), source_splats=0, sh_degree=0)
    tileset = open_tileset(path)
    turned = np.eye(4)
    turned[:3, :3] = 2 * np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # y becomes z, twice as large
    np.testing.assert_allclose(replace(tileset, transform=turned).up, [0, 1, 0], atol=1e-12)
    turned[:3, 3] = 0, 6.4e6, 0  # on the globe
    np.testing.assert_allclose(replace(tileset, transform=turned).up, [0, 0, -1], atol=1e-12)


_OPTIONAL = {"error", "files", "worth"}  # of older tilesets, and tiles with a single quality


def test_the_properties_of_every_tile_are_required() -> None:
    explicit = metadata_schema()["classes"][TILE_CLASS]["properties"]
    assert {name for name, entry in explicit.items() if not entry["required"]} == _OPTIONAL
    properties = [
        entry
        for schema in (metadata_schema(), implicit_metadata_schema())
        for group in schema["classes"].values()
        for name, entry in group["properties"].items()
        if name not in _OPTIONAL
    ]
    assert len(properties) > 10
    assert all(entry["required"] is True for entry in properties)


@pytest.mark.parametrize("is_implicit", [False, True])
def test_a_tile_tells_its_files_bytes_and_worth_at_each_quality(
    tmp_path: Path, is_implicit: bool
) -> None:
    """Implicit tiles keep sizes and worth in tables, and addresses in a template."""
    box = {"low": corner(0, 0, 0), "high": corner(1, 1, 1)}
    contents = tuple(
        ContentRecord(
            uri=implicit_uri(0, (0, 0, 0), q), size=90 - q, worth=1 - q / 8, error=q / 4, **box
        )
        for q in range(3)
    )
    root = record(0, (0, 0, 0), contents=contents)
    write = write_implicit_tileset if is_implicit else write_tileset
    write(tmp_path / "tileset.json", root, source_splats=1, sh_degree=0)
    tile = next(tile for tile in open_tileset(tmp_path).tiles() if tile.contents)
    assert tile.files == tuple(f"t/0/0_0_0-q{q}.glb" for q in range(3))
    assert tile.file_sizes == (90, 89, 88)
    assert tile.metadata["worth"] == [1, 0.875, 0.75]
    assert tile.metadata["error"] == [0, 0.25, 0.5]

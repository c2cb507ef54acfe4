"""Streamed SOG: the finest level of every leaf, wherever it lies."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import (
    FormatError,
    FormatWarning,
    HeaderMalformed,
    NotSupported,
    SizeExceeded,
    Splats,
    open_splats,
    read_sog,
    write_sog,
)
from gsgen.formats.shared.morton import grid_codes, grid_order
from gsgen.formats.sog.streamed_write import Chunks, write_levels
from gsgen.formats.sog.write import InMemory, write_sog_parts
from support.splat_files import FIELDS, GOLDENS, assert_near, scene


def rows(splats: Splats, index: np.ndarray) -> Splats:
    return replace(splats, **{name: getattr(splats, name)[index] for name in FIELDS})


@pytest.fixture
def tree(tmp_path: Path) -> dict:
    """Two files of level 0, a coarse one and an environment, of two leaves."""
    for number, name in enumerate(("0_0", "0_1", "1_0", "env")):
        (tmp_path / name).mkdir()
        write_sog(tmp_path / name / "meta.json", scene(20, 1, seed=number))
    fine = {"0": {"file": 0, "offset": 5, "count": 15}, "1": {"file": 2, "offset": 0, "count": 4}}
    coarse = {"1": {"file": 1, "offset": 0, "count": 7}, "12": {"file": 2, "offset": 9, "count": 1}}
    document = {
        "version": 1,
        "lodLevels": 2,
        "filenames": [f"{name}/meta.json" for name in ("0_0", "0_1", "1_0")],
        "tree": {"bound": {}, "children": [{"lods": fine}, {"lods": coarse}]},
    }
    (tmp_path / "lod-meta.json").write_text(json.dumps(document))
    return document


def test_each_leaf_gives_its_finest_level(tree: dict, tmp_path: Path) -> None:
    first, second = (read_sog(tmp_path / name / "meta.json") for name in ("0_0", "0_1"))
    splats = open_splats(tmp_path / "lod-meta.json")
    assert isinstance(splats, Splats)
    assert len(splats) == 22
    assert_near(rows(splats, np.arange(15)), rows(first, np.arange(5, 20)))
    assert_near(rows(splats, np.arange(15, 22)), rows(second, np.arange(7)))


def test_key_that_is_not_used_is_named(tmp_path, tree) -> None:
    (tmp_path / "lod-meta.json").write_text(json.dumps(tree | {"asset": {}, "time": 1}))
    with pytest.warns(FormatWarning, match="not used: key time$"):
        read_sog(tmp_path / "lod-meta.json")


def test_the_environment_is_part_of_the_scene(tree: dict, tmp_path: Path) -> None:
    (tmp_path / "lod-meta.json").write_text(json.dumps(tree | {"environment": "env/meta.json"}))
    splats = read_sog(tmp_path / "lod-meta.json")
    assert_near(rows(splats, np.arange(22, 42)), read_sog(tmp_path / "env" / "meta.json"))


def test_the_files_of_splat_transform_are_read() -> None:
    folder = GOLDENS / "streamed"
    assert_near(read_sog(folder / "lod-meta.json"), read_sog(folder / "0_0" / "meta.json"))


def leaf(**entry: object) -> dict:
    return {"tree": {"lods": {"0": {"file": 0, "offset": 0, "count": 3} | entry}}}


@pytest.mark.parametrize(
    "change",
    [
        {"filenames": ["../0_0/meta.json"]},
        {"filenames": ["/etc/passwd"]},
        {"filenames": ["lod-meta.json"]},
        {"filenames": "0_0/meta.json"},
        {"tree": None},
        {"tree": {"lods": {}}},
        {"tree": {"lods": {"0": 3}}},
        {"environment": "../x"},
        leaf(file=3),
        leaf(offset=-1),
        leaf(count=0),
        leaf(count=True),
        leaf(count=21),
        leaf(count=2**40),
        {"tree": {"children": [leaf()["tree"], leaf()["tree"]]}},
    ],
)
def test_invalid_trees_are_refused(tree: dict, tmp_path: Path, change: dict) -> None:
    (tmp_path / "lod-meta.json").write_text(json.dumps(tree | change))
    with pytest.raises(HeaderMalformed) as caught:
        read_sog(tmp_path / "lod-meta.json")
    assert caught.value.path


def test_deep_trees_missing_files_and_sizes_are_refused(tree: dict, tmp_path: Path) -> None:
    node = tree["tree"]
    for _ in range(70):
        node = {"children": [node]}
    file = tmp_path / "lod-meta.json"
    file.write_text(json.dumps(tree | {"tree": node}))
    with pytest.raises(HeaderMalformed, match=r"(?s)is at depth 65.*a depth of 64 or less"):
        read_sog(file)
    file.write_text(json.dumps(tree | {"filenames": ["none/meta.json"] * 3}))
    with pytest.raises(FormatError):
        read_sog(file)
    file.write_text(json.dumps(tree))
    with pytest.raises(SizeExceeded):
        read_sog(file, max_bytes=1000)


CHUNKS = Chunks(levels=3, file_rows=150, leaf_rows=20, leaf_size=1.0)


def write_small(path: Path, splats: Splats) -> None:
    """Write streamed SOG with several files and leaves, although the scene is small."""
    low, high = splats.position.min(axis=0), splats.position.max(axis=0)
    cells = np.rint((splats.position - low) / (high - low) * 65535).astype(np.int64)
    write = partial(write_sog_parts, is_sorted=True)
    order = grid_order(cells)
    write_levels(
        path,
        rows(splats, order),
        grid_codes(cells)[order],
        lambda file, part: write(file, InMemory(part)),
        CHUNKS,
    )


def leaves_of(node: dict) -> list[dict]:
    if "lods" in node:
        return [node]
    return [leaf for child in node["children"] for leaf in leaves_of(child)]


def test_a_streamed_sog_has_every_splat_once_in_the_box_of_its_leaf(tmp_path: Path) -> None:
    splats = scene(400, 1, seed=5)
    write_small(tmp_path / "lod-meta.json", splats)
    document = json.loads((tmp_path / "lod-meta.json").read_text())
    leaves = leaves_of(document["tree"])
    assert len(leaves) > 8
    assert document["counts"][0] == len(splats)
    assert document["count"] == sum(document["counts"])
    files = [read_sog(tmp_path / name) for name in document["filenames"]]
    assert max(map(len, files)) <= CHUNKS.file_rows
    selected = [np.zeros(len(file), int) for file in files]
    for leaf in leaves:
        assert sorted(leaf["lods"]) == ["0", "1", "2"]
        sizes = []
        for level in "012":
            entry = leaf["lods"][level]
            assert document["filenames"][entry["file"]].startswith(f"{level}_")
            range_ = slice(entry["offset"], entry["offset"] + entry["count"])
            selected[entry["file"]][range_] += 1
            sizes.append(entry["count"])
            position = files[entry["file"]].position[range_]
            low, high = (np.array(leaf["bound"][end]) for end in ("min", "max"))
            assert (position >= low - 1e-2).all()
            assert (position <= high + 1e-2).all()
        assert sizes[1] <= max(1, sizes[0] // 4)
        assert sizes[2] <= max(1, sizes[1] // 4)
    assert all((counts == 1).all() for counts in selected)


def test_a_written_streamed_sog_reads_as_one_file_does(tmp_path: Path) -> None:
    splats = scene(300, 2, seed=6)
    write_sog(tmp_path / "lod-meta.json", splats)
    restored = read_sog(tmp_path / "lod-meta.json")
    write_sog(tmp_path / "one.sog", splats)
    assert_near(restored, read_sog(tmp_path / "one.sog"))
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"lod-meta.json", "one.sog", "0_0", "1_0", "2_0", "3_0"}


def test_harmonics_that_sog_cannot_hold_leave_no_folder(tmp_path: Path) -> None:
    with pytest.raises(NotSupported, match="SH degree 4"):
        write_sog(tmp_path / "lod-meta.json", scene(3, 4))
    assert not list(tmp_path.iterdir())

"""Streamed SOG: the finest level of every leaf, wherever it lies."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import (
    FormatError,
    HeaderMalformed,
    NotSupported,
    SizeExceeded,
    Splats,
    open_splats,
    read_sog,
    write_sog,
)
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
def test_trees_that_cannot_be_are_refused(tree: dict, tmp_path: Path, change: dict) -> None:
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


def test_a_streamed_sog_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(
        NotSupported, match="the path is that of a streamed SOG, which gsgen cannot write"
    ):
        write_sog(tmp_path / "lod-meta.json", scene(3, 0))
    assert not list(tmp_path.iterdir())

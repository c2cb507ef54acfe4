"""Neural tiles: schema and reader agree, and GT020 sees each broken promise."""

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.contract.spec.manifest import Bounds
from gsgen.tiles import validate
from gsgen.tiles.build.frame import globe_transform
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.json_values import JsonObject
from gsgen.tiles.format.neural_tile import NEURAL_TILE_EXTENSION, neural_schema, read_neural_tile
from gsgen.tiles.format.volumes import Box, geodetic
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.validation.fixtures import _neural_sketch
from support.commands import ROOT

METRES = np.array([1 / 4.3e6, 1 / 6.4e6, 1.0])  # as longitude, latitude and height, at 47° north
GOOD = {
    "uri": "n/a.onnx",
    "contract": "1.0",
    "sha256": "0" * 64,
    "inputs": ["view", "time"],
    "splats_max": 100,
    "time_range": [0, 2],
}


def changed(**changes: Any) -> dict[str, Any]:
    entry = GOOD | changes
    return {key: value for key, value in entry.items() if value is not ...}


@pytest.mark.parametrize(
    ("entry", "valid"),
    [
        (GOOD, True),
        (changed(inputs=["view"], time_range=...), True),
        (changed(splats_max=0), False),
        (changed(splats_max=2.5), False),
        (changed(splats_max="9"), False),
        (changed(contract="2.0"), False),
        (changed(contract=1.0), False),
        (changed(sha256="0" * 63), False),
        (changed(sha256="G" * 64), False),
        (changed(inputs=[]), False),
        (changed(inputs=["time", "time"]), False),
        (changed(inputs=["colour"]), False),
        (changed(inputs="time"), False),
        (changed(time_range=...), False),
        (changed(time_range=[1]), False),
        (changed(time_range=["a", "b"]), False),
        (changed(inputs=["view"]), False),
        (changed(uri=""), False),
        (changed(uri=...), False),
    ],
)
def test_the_schema_and_the_reader_agree(entry: dict[str, Any], valid: bool) -> None:
    schema = neural_schema()
    Draft202012Validator.check_schema(schema)
    assert Draft202012Validator(schema).is_valid(entry) == valid
    if valid:
        tile = read_neural_tile(JsonObject(entry, "here"), "tileset.json")
        assert (tile.uri, tile.splats_max) == ("n/a.onnx", 100)
    else:
        with pytest.raises(TilesetInvalid) as caught:
            read_neural_tile(JsonObject(entry, "here"), "tileset.json")
        assert caught.value.fault is Fault.NEURAL


def test_the_published_schema_is_the_reader_s() -> None:
    path = ROOT / "docs" / "spec" / "schemas" / f"{NEURAL_TILE_EXTENSION}.schema.json"
    assert json.loads(path.read_text("utf-8")) == neural_schema()


def test_a_neural_tile_is_read_and_its_content_stays(tmp_path: Path) -> None:
    _neural_sketch().write(tmp_path / "tileset.json")
    tiles = [tile for tile in open_tileset(tmp_path).tiles() if tile.neural]
    (tile,) = tiles
    assert tile.neural is not None
    assert tile.neural.time_range == (0, 1)
    assert len(tile.contents) == 1
    assert len(read_leaves(tmp_path)) == 48


def held(document: dict[str, Any]) -> dict[str, Any]:
    entry: dict[str, Any] = document["root"]["children"][0]["extensions"][NEURAL_TILE_EXTENSION]
    return entry


def other_model(model: bytes) -> Callable[[Any], None]:
    def change(spec: Any) -> None:
        spec.files["n/leaf.onnx"] = model
        held(spec.document)["sha256"] = hashlib.sha256(model).hexdigest()

    return change


def without_file(spec: Any) -> None:
    del spec.files["n/leaf.onnx"]


def few_splats(spec: Any) -> None:
    held(spec.document)["splats_max"] = 4


def other_inputs(spec: Any) -> None:
    held(spec.document)["inputs"] = ["time", "view"]


def no_content(spec: Any) -> None:
    child = spec.document["root"]["children"][0]
    del child["content"], child["metadata"]
    spec.document["metadata"]["properties"]["source_splats"] -= 24
    del spec.files["gsgen.tiles.json"]
    child["geometricError"] = 0


def model_with_wide_bounds() -> bytes:
    bounds = Bounds((-1.5, -1.5, -9.0), (1.5, 1.5, 1.5))
    return drifting_model().with_manifest(bounds=bounds).build().SerializeToString()


def model_leaving_its_bounds() -> bytes:
    """A model whose splats leave its own bounds."""
    bounds = Bounds((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1))
    return drifting_model().with_manifest(bounds=bounds).build().SerializeToString()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without_file, "does not exist"),
        (few_splats, "splats_max"),
        (other_inputs, "time, view"),
        (other_model(b"no model"), "a Gaussian Generator"),
        (other_model(model_with_wide_bounds()), "reach 7 out"),
        (other_model(model_leaving_its_bounds()), "breaks"),
        (other_model(still().build().SerializeToString()), "inputs"),
    ],
    ids=["missing", "splats", "inputs", "bytes", "wide", "leaving", "still"],
)
def test_each_broken_promise_is_named(change, message: str, tmp_path: Path) -> None:
    spec = _neural_sketch()
    change(spec)
    spec.write(tmp_path / "tileset.json")
    report = validate(tmp_path / "tileset.json")
    assert {finding.rule for finding in report.findings} == {"GT020"}
    reported = " ".join(f"{f.where} {f.message}" for f in report.findings)
    assert message in reported, reported


def on_the_globe(spec: Any, margin: float) -> None:
    """Stand the tileset on the globe, in regions that hold the boxes and a margin in metres."""
    columns = globe_transform(8.5, 47.4, 400.0)
    matrix = np.array(columns).reshape(4, 4).T
    root = spec.document["root"]
    root["transform"] = list(columns)
    for tile, grown_margin in ((root["children"][0], margin), (root, 50.0)):
        numbers = np.array(tile["boundingVolume"]["box"])
        box = Box(numbers[:3], numbers[3:].reshape(3, 3)).transformed(matrix)
        angles = geodetic(box.samples())
        low, high = (np.array([f(axis) for axis in angles]) for f in (np.min, np.max))
        low, high = low - grown_margin * METRES, high + grown_margin * METRES
        region = [low[0], low[1], high[0], high[1], low[2], high[2]]
        tile["boundingVolume"] = {"region": list(map(float, region))}


def test_bounds_within_a_region_of_the_globe_are_compared_on_the_globe(tmp_path: Path) -> None:
    good = _neural_sketch()
    on_the_globe(good, margin=2.0)
    good.write(tmp_path / "good" / "tileset.json")
    report = validate(tmp_path / "good" / "tileset.json")
    assert report.verdict == "conforms", report.findings
    invalid_tile = _neural_sketch()
    on_the_globe(invalid_tile, margin=2.0)
    other_model(model_with_wide_bounds())(invalid_tile)
    invalid_tile.write(tmp_path / "bad" / "tileset.json")
    (finding,) = validate(tmp_path / "bad" / "tileset.json").findings
    assert finding.rule == "GT020"
    reach = re.search(r"reach ([\d.]+) out", finding.message)
    assert reach is not None, finding.message
    # 9 units down from the middle of a box of 1.6 or more, and a margin of 2.
    assert 4 < float(reach[1]) < 8


def test_neural_tile_without_content_breaks_gt020(tmp_path: Path) -> None:
    spec = _neural_sketch()
    no_content(spec)
    spec.write(tmp_path / "tileset.json")
    rules = {finding.rule for finding in validate(tmp_path).findings}
    assert "GT020" in rules

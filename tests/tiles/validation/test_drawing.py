"""Level ``render`` of tilesets: levels that differ are seen, and nothing undrawn is passed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.folder_sketch import FolderSketch
from gsgen.contract import Level, Report, Settings
from gsgen.formats import Splats, write_ply
from gsgen.tiles.build.build import build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.frame import upright_transform
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.progress import SilentProgress
from gsgen.tiles.gltf.placement import PlacedSplats
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.validation import drawing
from gsgen.tiles.validation import validate as validation
from gsgen.tiles.validation.drawing import ComparedLevels, DrawnTileset, draw_tileset
from gsgen.tiles.validation.sketches import explicit_sketch
from gsgen.tiles.validation.validate import validate
from support.tiles.level_scenes import knot

RENDER = Settings(level=Level.RENDER)


def turned(splats: Splats) -> Splats:
    return replace(splats, position=np.ascontiguousarray(splats.position[:, [1, 2, 0]]))


def shifted(splats: Splats) -> Splats:
    reach = np.ptp(splats.position[:, 0]) / 4
    return replace(splats, position=splats.position + np.array([reach, 0, 0], np.float32))


def halved(splats: Splats) -> Splats:
    return replace(splats, position=splats.position / 2)


def recolored(splats: Splats) -> Splats:
    order = np.random.default_rng(0).permutation(len(splats))
    return replace(splats, sh=splats.sh[order])


@pytest.fixture(scope="module")
def knot_tiles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("knot")
    write_ply(folder / "knot.ply", knot(12_000, degree=0))
    parameters = BuildParameters(leaf=600, transform=upright_transform())
    with open_engine("serial") as engine:
        build_tileset(
            [folder / "knot.ply"],
            folder / "tiles",
            parameters,
            engine=engine,
            progress=SilentProgress(),
        )
    return folder / "tiles"


def drawn(folder: Path) -> DrawnTileset:
    store, index = open_store(folder)
    with store:
        tileset = load_tileset(store, index, name=str(folder))
        counts = {
            content.uri: int(tile.metadata["splats"])
            for tile in tileset.tiles()
            for content in tile.contents
        }
        return draw_tileset(tileset, store, counts)


def edited_parents(edit: Callable[[Splats], Splats], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the renderer read other splats for every tile that others replace."""
    read = drawing._TileRenderer._read

    def read_edited(self, cut):
        parts = read(self, cut)
        if len(cut) > 1 or not cut[0][0].children:
            return parts
        center = np.mean([part.origin for part in parts], axis=0)
        return [PlacedSplats(edit(part.relative_to_origin(center)), center) for part in parts]

    monkeypatch.setattr(drawing._TileRenderer, "_read", read_edited)


def test_levels_of_a_build_agree(knot_tiles: Path) -> None:
    result = drawn(knot_tiles)
    assert len(result.tiles) == 2
    assert len(result.levels) == 2
    for pair in result.levels:
        assert pair.ssim > 0.65
        assert pair.pixels == pytest.approx(16, rel=0.02)
        assert pair.children > 1
    assert all(tile.covered > 0.9 for tile in result.tiles)


@pytest.mark.parametrize("edit", [turned, shifted, halved, recolored])
def test_parents_unlike_their_children_break_gt022(
    edit: Callable[[Splats], Splats], knot_tiles: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    edited_parents(edit, monkeypatch)
    report = validate(knot_tiles, RENDER)
    assert {finding.rule for finding in report.findings} == {"GT022"}
    assert {finding.certainty for finding in report.findings} == {"possible"}
    assert report.verdict == "conforms"


def write_tileset(spec: FolderSketch, folder: Path) -> Path:
    spec.write(folder / "tileset.json")
    return folder


def outcome(report: Report, rule: str) -> tuple[str, str]:
    return report.outcome(rule).status, report.outcome(rule).reason


def test_children_that_add_are_not_compared(tmp_path: Path) -> None:
    spec = explicit_sketch()
    spec.document["root"]["refine"] = "ADD"
    result = drawn(write_tileset(spec, tmp_path))
    assert result.levels == ()
    assert len(result.tiles) == 2


def test_child_equal_to_its_parent_has_ssim_one(tmp_path: Path) -> None:
    """A root with one child of the same content has SSIM 1."""
    spec = explicit_sketch()
    root = spec.document["root"]
    copy = {name: root[name] for name in ("boundingVolume", "content", "metadata")}
    root["children"] = [{**copy, "geometricError": 0.0}]
    (pair,) = drawn(write_tileset(spec, tmp_path)).levels
    assert pair == ComparedLevels(
        location="tileset.json, root", children=1, pixels=pair.pixels, ssim=1.0
    )


def test_gt022_is_skipped_for_tiles_with_too_many_splats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing, "MAX_DRAWN_SPLATS", 30)  # the children have 48, each tile fewer
    report = validate(write_tileset(explicit_sketch(), tmp_path), RENDER)
    status, reason = outcome(report, "GT022")
    assert status == "skipped"
    assert "48 splats, and 30" in reason
    assert outcome(report, "GT021") == ("pass", "")
    monkeypatch.setattr(drawing, "MAX_DRAWN_SPLATS", 20)
    assert outcome(validate(tmp_path, RENDER), "GT021")[0] == "skipped"


def test_a_machine_that_cannot_draw_skips_and_gives_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(validation, "find_spec", lambda name: None)
    report = validate(write_tileset(explicit_sketch(), tmp_path), RENDER)
    status, reason = outcome(report, "GT021")
    assert status == "skipped"
    assert "wgpu" in reason
    assert outcome(report, "GT022")[0] == "not-applicable"
    (level,) = (entry for entry in report.levels if entry.level is Level.RENDER)
    assert not level.ran
    assert "wgpu" in level.reason


def test_nothing_is_drawn_where_contents_are_broken(tmp_path: Path) -> None:
    spec = explicit_sketch(record=False)
    uri = spec.document["root"]["content"]["uri"]
    spec.files[uri] = spec.files[uri][:-40]
    report = validate(write_tileset(spec, tmp_path), RENDER)
    assert outcome(report, "GT021")[0] == "not-applicable"
    (level,) = (entry for entry in report.levels if entry.level is Level.RENDER)
    assert not level.ran

"""Builds of unusual scenes: single and equal splats, invalid values, other formats, faults."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid, GsgenError, InputUnreadable
from gsgen.formats import PointCloud, Splats, write_glb, write_ply, write_spz
from gsgen.formats.shared.splats import SPLAT_ARRAY_NAMES
from gsgen.tiles.build.build import build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.progress import SilentProgress
from gsgen.tiles.build.scan import scan_chunk
from gsgen.tiles.build.source import Chunk, open_scenes
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import open_tileset
from support.tiles.builds import SMALL, build
from support.tiles.tile_scenes import scattered


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.ply"
    write_ply(path, scattered(2000))
    return path


def test_harmonics_and_other_formats_are_put_together(tmp_path):
    near, far = scattered(1500, degree=1), scattered(800, degree=0, seed=1)
    moved = replace(far, position=far.position + np.float32(30))
    write_glb(tmp_path / "near.glb", near)
    write_spz(tmp_path / "far.spz", moved)
    build([tmp_path / "near.glb", tmp_path / "far.spz"], tmp_path / "tiles")
    leaves = read_leaves(tmp_path / "tiles" / "tileset.json")
    assert len(leaves) == 2300
    assert leaves.degree == 1


def test_a_single_splat_is_a_tileset(tmp_path):
    splats = scattered(10)
    write_ply(
        tmp_path / "one.ply",
        Splats(**{name: getattr(splats, name)[:1] for name in SPLAT_ARRAY_NAMES}),
    )
    report = build([tmp_path / "one.ply"], tmp_path / "tiles")
    assert (report.splats, report.tiles) == (1, 1)
    np.testing.assert_allclose(
        read_leaves(tmp_path / "tiles" / "tileset.json").position, splats.position[:1], atol=1e-3
    )


def test_many_duplicates_are_divided_by_number(tmp_path):
    same = scattered(10)
    row = Splats(
        **{name: np.repeat(getattr(same, name)[:1], 3000, axis=0) for name in SPLAT_ARRAY_NAMES}
    )
    write_ply(tmp_path / "same.ply", row)
    report = build([tmp_path / "same.ply"], tmp_path / "tiles")
    tileset = open_tileset(tmp_path / "tiles" / "tileset.json")
    counts = [tile.metadata["splats"] for tile in tileset.tiles() if not tile.children]
    assert sum(counts) == report.splats == 3000
    assert max(counts) <= SMALL.leaf


@pytest.mark.parametrize("origin", [1e5, -4e6])
def test_a_scene_far_from_the_origin_keeps_its_digits(tmp_path, origin):
    splats = scattered(3000, origin=origin)
    write_ply(tmp_path / "far.ply", splats)
    build([tmp_path / "far.ply"], tmp_path / "tiles")
    tileset = open_tileset(tmp_path / "tiles" / "tileset.json")
    assert tileset.root.volume.center[0] == pytest.approx(origin, abs=500)
    assert sum(t.metadata["splats"] for t in tileset.tiles() if not t.children) == 3000


def _with(splats: Splats, rows: slice, **values: float) -> Splats:
    arrays = {name: getattr(splats, name).copy() for name in values}
    for name, value in values.items():
        arrays[name][rows] = value
    return replace(splats, **arrays)


def test_rows_that_cannot_be_drawn_are_left_out_and_reported(tmp_path):
    splats = _with(scattered(2000), slice(7, 10), position=math.nan)
    splats = _with(splats, slice(20, 21), log_scale=math.inf)
    splats = _with(splats, slice(30, 31), sh=-math.inf)
    splats = _with(splats, slice(40, 41), logit_opacity=math.inf)  # opaque
    splats = _with(splats, slice(50, 60), log_scale=-math.inf)  # a point
    _write_unchecked(tmp_path / "bad.ply", splats)
    notes: list[str] = []

    class Notes(SilentProgress):
        def note(self, message: str) -> None:
            notes.append(message)

    with open_engine("serial") as engine:
        report = build_tileset(
            [tmp_path / "bad.ply"], tmp_path / "tiles", SMALL, engine=engine, progress=Notes()
        )
    assert (report.splats, report.skipped) == (1995, 5)
    assert len(notes) == 1
    assert "5 rows" in notes[0]
    assert "row 7" in notes[0]
    assert len(read_leaves(tmp_path / "tiles" / "tileset.json")) == 1995


def test_the_first_row_that_is_left_out_is_a_row_of_the_file(tmp_path):
    _write_unchecked(tmp_path / "bad.ply", _with(scattered(60), slice(54, 56), position=math.nan))
    (file,) = open_scenes([tmp_path / "bad.ply"])
    facts = scan_chunk(Chunk(index=0, file=file, first=47, count=13, source=0))
    assert (facts.count, facts.skipped, facts.first_skipped) == (11, 2, 54)
    facts = scan_chunk(Chunk(index=0, file=file, first=0, count=47, source=0))
    assert (facts.count, facts.skipped, facts.first_skipped) == (47, 0, -1)


def test_scales_beyond_the_codec_are_reported(tmp_path):
    write_ply(tmp_path / "huge.ply", _with(scattered(50), slice(3, 4), log_scale=8.0))
    for codec, expected in (("spz", 1), ("khr", 0)):
        notes: list[str] = []

        class Notes(SilentProgress):
            def note(self, message: str, notes: list[str] = notes) -> None:
                notes.append(message)

        with open_engine("serial") as engine:
            build_tileset(
                [tmp_path / "huge.ply"],
                tmp_path / codec,
                replace(SMALL, codec=codec),
                engine=engine,
                progress=Notes(),
            )
        assert len(notes) == expected
        assert all("2980.96" in note and "--codec khr" in note for note in notes)


def _write_unchecked(path: Path, splats: Splats) -> None:
    """Write a PLY file with values that ``write_ply`` refuses."""
    write_ply(path, scattered(len(splats)))
    header = path.read_bytes().partition(b"end_header\n")[0] + b"end_header\n"
    columns = (splats.position, splats.sh.reshape(len(splats), -1))
    columns += (splats.logit_opacity[:, None], splats.log_scale, splats.rotation)
    rows = np.concatenate(columns, axis=1).astype("<f4")
    names = [line.split()[-1] for line in header.decode().splitlines() if "property" in line]
    layout = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    layout += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    path.write_bytes(header + rows[:, [layout.index(name) for name in names]].tobytes())


def test_invisible_splats_are_kept_in_leaves_and_not_above(tmp_path):
    splats = _with(scattered(3000), slice(None), logit_opacity=-math.inf)
    write_ply(tmp_path / "dark.ply", splats)
    report = build([tmp_path / "dark.ply"], tmp_path / "tiles")
    assert report.splats == 3000
    root = open_tileset(tmp_path / "tiles" / "tileset.json").root
    assert root.metadata["splats"] == 1


def test_one_enormous_splat_does_not_widen_the_tiles_below(tmp_path):
    splats = _with(scattered(5000), slice(3, 4), log_scale=5.9)
    write_ply(tmp_path / "huge.ply", splats)
    build([tmp_path / "huge.ply"], tmp_path / "tiles")
    tileset = open_tileset(tmp_path / "tiles" / "tileset.json")
    sizes = sorted(tile.volume.size for tile in tileset.tiles() if not tile.children)
    assert sizes[-1] == pytest.approx(6 * math.sqrt(3) * math.exp(5.9), rel=0.1)
    assert sizes[-2] < 0.2 * sizes[-1]
    assert sum(t.metadata["splats"] for t in tileset.tiles() if not t.children) == 5000


def refused(error: type[GsgenError], words: str, *arguments: object, **options: object) -> None:
    with pytest.raises(error) as caught:
        build(*arguments, **options)
    assert words in str(caught.value)


def test_a_faulty_scene_raises(tmp_path, scene):
    refused(InputUnreadable, "No such file", [tmp_path / "missing.ply"], tmp_path / "tiles")
    (tmp_path / "short.ply").write_bytes(scene.read_bytes()[:100_000])
    refused(InputUnreadable, "bytes", [tmp_path / "short.ply"], tmp_path / "tiles")
    points = PointCloud(np.zeros((2, 3), np.float32), np.zeros((2, 3), np.float32))
    write_ply(tmp_path / "points.ply", points)
    refused(InputUnreadable, "coloured points", [tmp_path / "points.ply"], tmp_path / "tiles")
    splats = scattered(50)
    write_spz(tmp_path / "a.spz", replace(splats, antialiased=True))
    refused(ConfigInvalid, "antialiased is False", [tmp_path / "a.spz", scene], tmp_path / "tiles")
    _write_unchecked(tmp_path / "nan.ply", _with(splats, slice(None), position=math.nan))
    refused(
        InputUnreadable,
        "none of the 50 splats has finite values",
        [tmp_path / "nan.ply"],
        tmp_path / "tiles",
    )


def test_an_unfit_output_folder_raises(tmp_path, scene):
    (tmp_path / "file").write_text("x")
    refused(ConfigInvalid, "is a file", [scene], tmp_path / "file")
    refused(ConfigInvalid, "no build wrote", [scene], tmp_path)
    assert (tmp_path / "file").read_text() == "x"

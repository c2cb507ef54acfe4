"""Builds with generators: the files, the first frame as content, and what is refused."""

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.formats import write_ply
from gsgen.tiles import validate
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.loading.tileset_loader import open_tileset
from support.commands import gsgen_here
from support.tiles.tile_scenes import digests, scattered

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of one leaf, and a generator that drifts from time 2 to 4."""
    folder = tmp_path_factory.mktemp("neural")
    write_ply(folder / "scene.ply", scattered(300))
    (folder / "a fountain.onnx").write_bytes(
        drifting_model(span=(2.0, 4.0)).build().SerializeToString()
    )
    return folder


def build(folder: Path, output: Path, *words: object) -> str:
    words = (folder / "scene.ply", "-o", output, "--engine", "serial", *words)
    completed = gsgen_here("tiles", "build", *words)
    assert completed.code == 0, completed.err
    return completed.out


def test_a_generator_becomes_a_tile_that_conforms(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "tiles"
    model = folder / "a fountain.onnx"
    assert "305 splats in 2 tiles" in build(folder, output, "--neural", model)
    tileset = open_tileset(output)
    assert tileset.root.refine == "ADD"
    scene, tile = tileset.root.children
    assert scene.neural is None
    assert tile.neural is not None
    assert (output / tile.neural.uri).read_bytes() == model.read_bytes()
    assert (tile.neural.splats_max, tile.neural.time_range) == (5, (2.0, 4.0))
    report = validate(output)
    assert report.verdict == "conforms", report.findings
    assert report.outcome("GT020").status == "pass"
    # The content has the rows of the first time, as ONNX Runtime computes them.
    session = onnxruntime.InferenceSession(model.read_bytes())
    rows = session.run(None, {"time": np.float32([2.0])})[0]
    leaves = read_leaves(output).position
    assert len(leaves) == 305
    for row in rows[:, :3]:
        assert np.abs(leaves - row).max(axis=1).min() < 1 / 4096
    # The same build is up to date; without the generator, its files are gone.
    first = digests(output)
    assert "up to date" in build(folder, output, "--neural", model)
    build(folder, tmp_path / "again", "--neural", model)
    assert digests(tmp_path / "again") == first
    build(folder, output)
    assert not (output / "n").exists()
    assert "extensions" not in json.loads((output / "tileset.json").read_text())["root"]


def test_generators_that_cannot_be_tiles_are_refused(folder: Path, tmp_path: Path) -> None:
    constant = tmp_path / "constant.onnx"
    constant.write_bytes(still(5).build().SerializeToString())
    unbounded = tmp_path / "unbounded.onnx"
    unbounded.write_bytes(drifting_model().with_manifest(bounds=None).build().SerializeToString())
    good = folder / "a fountain.onnx"
    for words, message in (
        ((constant,), "lacks inputs"),
        ((unbounded,), "lacks bounds"),
        ((folder / "scene.ply",), "scene.ply"),
        ((good, "--implicit"), "cannot be combined with --implicit"),
    ):
        completed = gsgen_here(
            "tiles", "build", folder / "scene.ply", "-o", tmp_path / "t", "--neural", *words
        )
        assert completed.code in (2, 4), completed.out
        assert message in completed.err
        assert "Traceback" not in completed.err
        assert not (tmp_path / "t").exists()

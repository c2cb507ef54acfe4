"""`gsgen export static` goes through the pipeline of every export."""

import json
from pathlib import Path

import numpy as np
import onnx
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.formats import PackedRows, PointCloud, write_ply
from gsgen.reference_plugins.static.static import StaticScene
from gsgen.reference_plugins.synthetic import torus_knot
from gsgen.sdk import ExportRejected, ParityFailed, Plugin
from gsgen.sdk.exporting.constant_generator import _check_written_model, export_constant
from gsgen.sdk.plugins.plugin import installed_plugins
from support.commands import gsgen_here

STATIC = Settings(level=Level.STATIC)


def points() -> PointCloud:
    """Return points, whose RGB the target visionary cannot read."""
    return PointCloud(np.eye(3, dtype=np.float32), np.ones((3, 3), np.float32))


def packed(dtype: type) -> PackedRows:
    rows = np.zeros((4, 10), dtype)
    rows[:, 3], rows[:, [4, 7, 9]] = 0.5, 0.01
    return PackedRows(rows, np.zeros((4, 48), dtype))


def test_static_is_an_ordinary_plugin() -> None:
    (plugin,) = (entry for entry in installed_plugins() if entry.name == "static")
    assert isinstance(plugin, Plugin)
    assert plugin.build is not None
    assert plugin.command is None


def test_rows_that_break_a_rule_are_rejected_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    np.savez("points.npz", points=points().position, colors=points().color)
    completed = gsgen_here(
        *("export", "static", "points.npz", "-o", "m.onnx", "--report", "r.json"),
        *("--level", "static", "--target", "visionary", "--json"),
    )
    assert completed.code == 1
    assert "gsgen: m.onnx was not written" in completed.err
    assert not Path("m.onnx").exists()
    report = json.loads(Path("r.json").read_text(encoding="utf-8"))
    assert json.loads(completed.out) == report
    assert (report["written"], report["source"]) == (False, "static")
    assert report["error"]["kind"] == "ExportRejected"
    assert report["options"]["dtype"] == "float32"
    assert report["validation"]["verdict"] != "conforms"


def test_packed_rows_pass_through_even_if_they_break_a_rule(tmp_path: Path) -> None:
    rows = packed(np.float32)
    rows.gaussians[:] = np.nan
    path = tmp_path / "m.onnx"
    settings = Settings(level=Level.VALUES)
    result = export_constant(StaticScene(content=rows), path, settings=settings)
    assert result.report.verdict != "conforms"
    assert path.exists()


def test_a_model_whose_output_differs_from_the_source_is_refused(tmp_path: Path) -> None:
    rows = packed(np.float32)
    rows.gaussians[0, 0] = np.nan
    path = tmp_path / "m.onnx"
    export_constant(StaticScene(content=rows), path, settings=STATIC)
    (name,) = (entry.name for entry in onnx.load(path).graph.output if "gauss" in entry.name)
    _check_written_model(path, {name: rows.gaussians})
    other = rows.gaussians.copy()
    other[0, 0], other[1, 2] = 1.0, np.nan
    with pytest.raises(ParityFailed, match="2 of 40 output values differ from the source's"):
        _check_written_model(path, {name: other})


def test_a_rejected_model_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    path.write_text("old")
    scene = StaticScene(content=points())
    with pytest.raises(ExportRejected):
        export_constant(scene, path, target="visionary", settings=STATIC)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_packed_rows_keep_their_dtype_unless_another_is_requested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dtype: str
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = packed(np.dtype(dtype).type)
    np.savez("rows.npz", gaussians=rows.gaussians, appearance=rows.appearance)
    words = ("export", "static", "rows.npz", "-o", "m.onnx", "--level", "static")
    for options, expected in (((), dtype), (("--dtype", "float32"), "float32")):
        completed = gsgen_here(*words, "--report", "r.json", *options)
        assert completed.code == 0, completed.err
        assert f"m.onnx: 4 packed rows, {expected}" in completed.out
        report = json.loads(Path("r.json").read_text(encoding="utf-8"))
        assert report["options"]["dtype"] == expected
        assert (report["parity"], report["rewrites"]) == (None, [])


def test_a_capacity_below_the_rows_is_refused_with_a_hint(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match="3 is less than the 5 packed Gaussians") as caught:
        export_constant(StaticScene(content=torus_knot(5)), tmp_path / "m.onnx", capacity=3)
    assert (caught.value.where, caught.value.hint) == (
        "--capacity",
        "Give 5 or more, or leave it out.",
    )


def test_options_take_precedence_over_the_file(tmp_path: Path) -> None:
    scene = StaticScene(content=torus_knot(5), color_space="linear", antialias="mip")
    result = export_constant(scene, tmp_path / "m.onnx", name="knot", opset=17, settings=STATIC)
    manifest = result.manifest
    assert manifest.outputs.appearance is not None
    assert (manifest.name, manifest.family) == ("knot", "static")
    assert (manifest.outputs.appearance.color_space, manifest.antialias) == ("linear", "mip")
    assert onnx.load(tmp_path / "m.onnx").opset_import[0].version == 17


def test_no_plugin_overwrites_the_file_that_it_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_ply("knot.ply", torus_knot(5))
    before = Path("knot.ply").read_bytes()
    completed = gsgen_here("export", "static", "knot.ply", "-o", "knot.ply")
    assert completed.code == 2
    assert "would be overwritten" in completed.err
    assert Path("knot.ply").read_bytes() == before

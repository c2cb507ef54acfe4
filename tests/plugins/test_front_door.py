"""The names of ``gsgen`` itself: lazy, in the words of the commands, with errors of files."""

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import gsgen
from gsgen.conformance.fixtures import find
from gsgen.contract import Settings
from gsgen.contract.errors import ConfigInvalid, GsgenError, ModelUnreadable, UnknownName
from gsgen.contract.spec.severity import Level
from gsgen.formats import FileUnreadable, NotSupported, Splats, write_ply
from support.commands import gsgen_here
from support.splat_files import scene


def test_the_import_loads_nothing_and_names_everything() -> None:
    script = (
        "import sys, gsgen; print(*[n for n in sys.modules if n.startswith('gsgen')], *dir(gsgen))"
    )
    words = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()
    assert [word for word in words if word.startswith("gsgen.")] == []
    assert set(gsgen.__all__) <= set(words)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        gsgen.nothing  # noqa: B018


def test_a_report_prints_as_the_command_prints_it(tmp_path: Path) -> None:
    path = find("opacity_is_logits").write(tmp_path)
    report = gsgen.validate(path, level="values")
    assert f"{report}\n" == gsgen_here("validate", path, "--level", "values").out
    assert len(repr(report)) < 300
    assert "invalid" in repr(report)


def test_a_report_takes_the_options_of_the_command(tmp_path: Path) -> None:
    path = find("opacity_is_logits").write(tmp_path)
    assert gsgen.validate(path, only=["GV003"], ignore=["opacity-range"]).verdict == "conforms"
    with pytest.raises(UnknownName, match=r"level: unknown level 'full'\n  Did you mean 'render'"):
        gsgen.validate(path, level="full")


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        (lambda folder: gsgen.load(folder / "no.ply"), FileUnreadable),
        (lambda folder: gsgen.validate(folder / "no.onnx"), ModelUnreadable),
        (lambda folder: gsgen.convert(folder / "no.ply", folder / "a.spz"), FileUnreadable),
        (lambda folder: gsgen.render(folder / "no.ply"), GsgenError),
        (lambda folder: gsgen.bake(folder / "no.onnx", folder / "a.ply"), ModelUnreadable),
    ],
)
def test_a_missing_file_is_an_error_of_files_too(call, kind, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        call(tmp_path)
    assert isinstance(caught.value, kind)
    assert "no." in str(caught.value)
    assert "No such file" in str(caught.value)


def test_settings_take_words_and_refuse_other_types() -> None:
    settings = Settings(level="static", target="webgpu", fail_on="warning")  # type: ignore[arg-type]
    assert (settings.level, settings.target.name) == (Level.STATIC, "webgpu")
    for name, value in {"level": 3, "target": None, "fail_on": 1.5, "limits": 3}.items():
        with pytest.raises(ConfigInvalid, match=rf"^{name}: is {value}, expected"):
            Settings(**{name: value})  # type: ignore[arg-type]


def test_activated_values_are_those_of_the_stored_ones() -> None:
    splats = scene(50, 2)
    # The sigmoid and the exponential in double precision, written out.
    logits = splats.logit_opacity.astype(np.float64)
    np.testing.assert_allclose(splats.opacity, 1 / (1 + np.exp(-logits)), atol=1e-6)
    np.testing.assert_allclose(splats.scale, np.exp(splats.log_scale.astype(np.float64)), rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(splats.quaternion, axis=1), 1, atol=1e-6)
    constant = 0.28209479177387814 * splats.sh[:, 0].astype(np.float64)
    np.testing.assert_allclose(splats.rgb, np.clip(constant + 0.5, 0, 1), atol=1e-6)
    assert splats.xyz is splats.position
    values = (splats.opacity, splats.scale, splats.quaternion, splats.rgb)
    assert {value.dtype for value in values} == {np.dtype("float32")}


def test_opacity_has_no_warning_at_infinite_logits() -> None:
    splats = scene(3, 0)
    splats.logit_opacity[:] = [np.inf, -np.inf, 1e4]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert splats.opacity.tolist() == [1, 0, 1]


@pytest.mark.parametrize("rows", [slice(10), np.arange(7) * 3, [0, 4], slice(None, None, -1)])
def test_some_splats_keep_what_all_say(rows) -> None:
    splats = scene(50, 1)
    part = splats[rows]
    np.testing.assert_array_equal(part.position, splats.position[rows])
    np.testing.assert_array_equal(part.sh, splats.sh[rows])
    assert (part.up, part.color_space, part.degree) == (splats.up, splats.color_space, 1)
    assert len(splats[splats.opacity > 2]) == 0


def test_splats_are_saved_by_suffix(tmp_path: Path) -> None:
    splats = scene(20, 1)
    splats.save(tmp_path / "a.ply")
    np.testing.assert_array_equal(gsgen.load(tmp_path / "a.ply").sh, splats.sh)
    with pytest.raises(NotSupported, match=r"a\.foo"):
        splats.save(tmp_path / "a.foo")
    with pytest.raises(NotSupported, match="ksplat"):
        splats.save(tmp_path / "a.ksplat")


def test_packed_rows_are_loaded_as_splats(tmp_path: Path) -> None:
    rows = np.zeros((4, 10), np.float32)
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.04
    colors = np.full((4, 3), 0.25, np.float32)
    np.savez(tmp_path / "a.npz", gaussians=rows, appearance=colors)
    splats = gsgen.load(tmp_path / "a.npz")
    assert isinstance(splats, Splats)
    np.testing.assert_allclose(splats.scale, 0.2, rtol=1e-5)
    np.testing.assert_allclose(splats.opacity, 0.8, rtol=1e-5)


def test_a_method_is_named_by_any_of_its_words(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(20, 1))
    exported = gsgen.export(tmp_path / "a.ply", tmp_path / "a.onnx", method="3dgs", level="static")
    assert exported.report.verdict == "conforms"
    with pytest.raises(UnknownName, match="'hexplane-4dgs' or 'rotor-4dgs'"):
        gsgen.export(tmp_path / "a.ply", tmp_path / "b.onnx", method="4dgs")


def test_a_picture_is_drawn_and_saved(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(20, 1))
    frame = gsgen.render(tmp_path / "a.ply", tmp_path / "a.png", size=(32, 24), background="white")
    assert frame.alpha.shape == (24, 32)
    frame.save(tmp_path / "b.png")
    frame.save(tmp_path / "b.jpg")
    from PIL import Image

    with Image.open(tmp_path / "a.png") as drawn, Image.open(tmp_path / "b.png") as saved:
        np.testing.assert_array_equal(np.asarray(drawn.convert("RGBA")), np.asarray(saved))
    with pytest.raises(ConfigInvalid, match=r"has the suffix \.foo"):
        frame.save(tmp_path / "b.foo")

"""Splatter Image and LGM against their own code, and against plain formulas in float64."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
import yaml
from PIL import Image
from typer.testing import CliRunner

from gsgen.cli.command_group import build
from gsgen.contract.model.model_file import open_model
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.formats import PackedRows, splats_of_rows, write_ply
from gsgen.reference_plugins.feed_forward.lgm_checkpoint import read_lgm
from gsgen.reference_plugins.feed_forward.splatter_image_checkpoint import read_splatter_image
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.synthetic import write_lgm, write_splatter_image
from gsgen.runtime.scene.camera import Camera
from gsgen.sdk import export
from plugins.feed_forward.cases import CASES, GOLDENS, Case
from plugins.feed_forward.feed_forward_oracle import lgm, splatter_image
from support.checkpoints.plugin_checks import ALLOWED, assert_golden, assert_like, eager
from support.commands import gsgen_here
from support.models.captured import assert_captured

each_case = pytest.mark.parametrize("name", CASES)


def golden_pairs(
    name: str, rows: np.ndarray, color: np.ndarray
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Return the rows of a golden, and what the method's own code computed for them."""
    saved = np.load(GOLDENS / f"{name}.npz")
    return rows[saved["rows"]], color[saved["rows"]], {field: saved[field] for field in ALLOWED}


@each_case
def test_the_method_s_own_code_gives_the_same_gaussians(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    generator = case.generator(case.write(tmp_path))
    assert_golden(*golden_pairs(name, *eager(generator, *case.inputs())), ALLOWED)


@each_case
def test_plain_formulas_in_float64_give_the_same_gaussians(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    folder = case.write(tmp_path)
    if case.method == "lgm":
        expected = lgm(folder, case.images())
    else:
        expected = splatter_image(folder, case.images(), case.views(), case.focals())
    assert_like(*eager(case.generator(folder), *case.inputs()), expected)


def test_gaussians_turn_with_the_cameras_of_their_pictures(tmp_path: Path) -> None:
    case = Case("splatter_image", {"seed": 1}, pictures=2)
    folder = case.write(tmp_path)
    generator = case.generator(folder)
    images, views = case.images(), case.views().astype(np.float64)
    world = np.eye(4)
    world[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    world[:3, :3] *= np.sign(np.linalg.det(world[:3, :3]))
    world[:3, 3] = (2.0, -1.0, 0.5)
    moved = (views @ np.linalg.inv(world)).astype(np.float32)
    expected = splatter_image(folder, images, moved)
    assert_like(*eager(generator, images, moved.swapaxes(1, 2)), expected)
    still = splatter_image(folder, images, case.views())
    centers = still.position @ world[:3, :3].T + world[:3, 3]
    assert np.abs(centers - expected.position).max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "level"), [("splatter_image_two_views", Level.LIVE), ("lgm_small", Level.BEHAVIOUR)]
)
def test_an_exported_model_agrees_with_the_method(name: str, level: Level, tmp_path: Path) -> None:
    case = CASES[name]
    generator = case.generator(case.write(tmp_path / "run"))
    path = tmp_path / "model.onnx"
    # A driver in software takes minutes for the frames of a network.
    settings = Settings(level=level, limits=replace(Limits(), seconds=600.0))
    exported = export(generator, path, target="webgpu", settings=settings)
    if level is Level.LIVE:
        assert_captured(exported.report)
    session = onnxruntime.InferenceSession(path)
    names = [entry.name for entry in session.get_inputs()]
    rows, color, *_ = session.run(None, dict(zip(names, case.inputs(), strict=True)))
    assert_golden(*golden_pairs(name, rows, color), ALLOWED)


def test_a_command_exports_and_the_manifest_says_how_pictures_are_laid_over_white(
    tmp_path: Path,
) -> None:
    write_splatter_image(tmp_path / "run", side=16)
    words = ["export", "splatter-image", "--checkpoint", str(tmp_path / "run")]
    words += ["-o", str(tmp_path / "car.onnx"), "--level", "static"]
    completed = CliRunner().invoke(build(), words)
    assert completed.exit_code == 0, completed.output
    assert "1 picture of 16×16, 256 Gaussians of SH degree 1" in completed.stderr
    manifest = open_model(tmp_path / "car.onnx").manifest_text
    assert manifest is not None
    assert '"background": [1.0, 1.0, 1.0]' in manifest


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("data.category", "objaverse", "data.category is 'objaverse', expected one of cars"),
        ("model.max_sh_degree", 2, "model.max_sh_degree is 2, expected 0 or 1"),
        ("cam_embd.embedding", "index", "cam_embd.embedding is 'index', expected pose"),
        ("data.znear", None, "data.znear is None, expected a number"),
        ("model.base_dim", 64, "no first convolution for model.base_dim 64"),
        ("model.num_blocks", 2, "missing: enc.16x16_block1"),
        ("model.network_with_offset", False, "no tensors of network_wo_offset"),
    ],
)
def test_options_that_are_not_supported_are_named(
    name: str, value: object, message: str, tmp_path: Path
) -> None:
    write_splatter_image(tmp_path, side=16)
    path = tmp_path / ".hydra" / "config.yaml"
    config = yaml.safe_load(path.read_text("utf-8"))
    section, _, key = name.partition(".")
    config[section][key] = value
    path.write_text(yaml.safe_dump(config), "utf-8")
    with pytest.raises(CheckpointInvalid, match=message):
        read_splatter_image(tmp_path)


def test_a_missing_or_broken_file_of_options_is_named(tmp_path: Path) -> None:
    write_splatter_image(tmp_path, side=16)
    path = tmp_path / ".hydra" / "config.yaml"
    for text in ("a: [", "- 1", "!!python/object/apply:os.system ['true']"):
        path.write_text(text, "utf-8")
        with pytest.raises(CheckpointInvalid, match=r"cannot be read|holds no options"):
            read_splatter_image(tmp_path)
    path.unlink()
    with pytest.raises(CheckpointInvalid, match="does not exist"):
        read_splatter_image(tmp_path)


def test_weights_of_lgm_are_read_from_both_kinds_of_file(tmp_path: Path) -> None:
    first = read_lgm(write_lgm(tmp_path / "a"))
    second = read_lgm(write_lgm(tmp_path / "b", is_pickled=True) / "model.pth")
    assert first.unet.options == second.unet.options
    assert torch.equal(first.head[0], second.head[0])


def test_sides_that_the_network_cannot_halve_are_refused(tmp_path: Path) -> None:
    write_lgm(tmp_path)
    with pytest.raises(NotInCheckpoint, match="is 30, expected a multiple of 4"):
        Case("lgm", side=30).generator(tmp_path)


def test_another_network_is_not_taken_for_lgm(tmp_path: Path) -> None:
    torch.save({"unet.weight": torch.zeros(3)}, tmp_path / "other.pth")
    with pytest.raises(CheckpointInvalid, match="0 levels down and 0 up"):
        read_lgm(tmp_path / "other.pth")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["splatter_image_two_views", "lgm_small"])
def test_one_command_makes_the_film_of_picture_files(name: str, tmp_path: Path) -> None:
    """The film is that of the rows which torch computes from the same pictures."""
    case, model = CASES[name], tmp_path / "model.onnx"
    generator = case.generator(case.write(tmp_path / "run"))
    export(generator, model, target="webgpu", settings=Settings(level=Level.STATIC))
    pixels = np.round(255 * case.images()).astype(np.uint8)
    files = [tmp_path / f"{number}.png" for number in range(case.pictures)]
    for file, picture in zip(files, pixels, strict=True):
        Image.fromarray(picture.transpose(1, 2, 0)).save(file)
    words = ["--image", ",".join(map(str, files))]
    inputs = [pixels.astype(np.float32) / 255, *case.inputs()[1:]]
    if len(inputs) > 1:
        lens = {
            "fx": 16.0,
            "fy": 16.0,
            "cx": 8.0,
            "cy": 8.0,
            "width": case.side,
            "height": case.side,
        }
        cameras = [json.loads(Camera(view, **lens).to_json()) for view in case.views()]
        (tmp_path / "cameras.json").write_text(json.dumps(cameras), "utf-8")
        words += ["--image-cameras", str(tmp_path / "cameras.json")]
    rows = PackedRows(*eager(generator, *inputs))
    write_ply(tmp_path / "rows.ply", splats_of_rows(rows))
    view = ("--camera", "look-at:1,-1,-2,0,0,1", "--up", "-y", "--size", "48x32")
    for scene, more in ((model, words), (tmp_path / "rows.ply", [])):
        output = tmp_path / f"{scene.stem}.npy"
        assert gsgen_here("render", scene, *more, *view, "-o", output).code == 0
    actual, expected = (np.load(tmp_path / f"{stem}.npy") for stem in ("model", "rows"))
    assert expected[..., :3].max() > 0.2
    np.testing.assert_allclose(actual, expected, atol=1e-3)
    film = (*words, "--camera", "orbit", "--frames", "3", "--size", "48x32")
    filmed = gsgen_here("render", model, *film, "-o", tmp_path / "film.mp4")
    assert filmed.code == 0
    assert "film.mp4: 3 frames of 48×32" in filmed.out + filmed.err

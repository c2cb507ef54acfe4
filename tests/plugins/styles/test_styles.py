"""Published style networks against their own code, and against plain formulas in float64."""

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from typer.testing import CliRunner

from gsgen.cli.command_group import build as build_program
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.images.stylise_plugin import build
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.styles.style_transfer import StyleTransfer
from gsgen.reference_plugins.synthetic import write_adain, write_anime_gan, write_fast_neural_style
from gsgen.sdk.exporting.post_process_exporter import export_post_process
from plugins.styles.cases import CASES, GOLDENS, Case
from plugins.styles.style_oracle import redrawn
from support.checkpoints.image_goldens import ALLOWED, MARGIN, assert_image_golden
from support.models.captured import assert_captured

each_case = pytest.mark.parametrize("name", CASES)


def network_of(case: Case, path: Path) -> StyleTransfer:
    """Build the network of a written case; the style's picture keeps its size."""
    options = {"style": path / "style.png", "style_size": 0} if case.method == "adain" else {}
    size = f"{case.size[1]}x{case.size[0]}"
    network = build(path, size, slider=case.amount < 1, align_corners=case.align_corners, **options)
    return network.eval()


def inputs_of(case: Case) -> dict[str, np.ndarray]:
    style = {"style": np.array([case.amount], np.float32)} if case.amount < 1 else {}
    return {"image": case.image(), **style}


@each_case
def test_the_method_and_plain_formulas_in_float64_give_the_same_image(
    name: str, tmp_path: Path
) -> None:
    case = CASES[name]
    path = case.write(tmp_path)
    with torch.no_grad():
        tensors = [torch.from_numpy(value) for value in inputs_of(case).values()]
        result = network_of(case, path)(*tensors).numpy()
    assert_image_golden(GOLDENS / f"{name}.npz", result, limits=(0, 1))
    assert np.abs(result[0] - np.clip(redrawn(case, path), 0, 1)).max() <= ALLOWED


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float16"])
@each_case
def test_the_model_agrees_with_the_method_three_times_better_than_asked(
    name: str, dtype: str, tmp_path: Path
) -> None:
    case = CASES[name]
    network = network_of(case, case.write(tmp_path))
    path = tmp_path / "model.onnx"
    settings = Settings(level=Level.STATIC)
    export_post_process(network, path, dtype=dtype, target="webgpu", settings=settings)
    feeds = inputs_of(case)
    feeds["image"] = feeds["image"].astype(dtype)
    (result,) = onnxruntime.InferenceSession(path).run(None, feeds)
    allowed = network.half_tolerance if dtype == "float16" else network.tolerance
    assert_image_golden(GOLDENS / f"{name}.npz", result, allowed / MARGIN, limits=(0, 1))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fast_neural_style", "anime_gan", "adain_odd"])
def test_models_are_captured_and_replayed_in_webgpu(name: str, tmp_path: Path) -> None:
    network = network_of(CASES[name], CASES[name].write(tmp_path))
    settings = Settings(level=Level.LIVE)
    exported = export_post_process(
        network, tmp_path / "model.onnx", target="webgpu", settings=settings
    )
    assert_captured(exported.report)


def test_the_slider_mixes_the_image_and_its_redrawing(tmp_path: Path) -> None:
    network = build(write_anime_gan(tmp_path / "anime.pth"), "16x24").eval()
    image = torch.rand(1, 3, 16, 24)
    with torch.no_grad():
        full, half = network(image), network(image, torch.tensor([0.5]))
    torch.testing.assert_close(half, (image + full) / 2)


def test_the_style_of_adain_is_resized_by_its_shorter_side(tmp_path: Path) -> None:
    folder = CASES["adain"].write(tmp_path)
    means = [
        build(folder, "16x16", style=folder / "style.png", style_size=side).style_mean
        for side in (0, 40, 20)
    ]
    assert torch.equal(means[0], means[1])  # the picture is 40 × 56
    assert not torch.equal(means[0], means[2])


def test_options_of_another_network_are_refused(tmp_path: Path) -> None:
    folder = CASES["adain"].write(tmp_path)
    with pytest.raises(ConfigInvalid, match="AdaIN needs a picture of the style"):
        build(folder, "16x16")
    file = write_fast_neural_style(tmp_path / "one.pth")
    with pytest.raises(ConfigInvalid, match="belongs to AdaIN, but the network was trained for"):
        build(file, "16x16", style=folder / "style.png")
    (tmp_path / "text.png").write_text("no picture", "utf-8")
    with pytest.raises(ConfigInvalid, match="cannot be read"):
        build(folder, "16x16", style=tmp_path / "text.png")


def test_files_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    torch.save({"conv.weight": torch.zeros(1)}, tmp_path / "other.pth")
    with pytest.raises(CheckpointInvalid, match=r"fast neural style .*AnimeGANv2 .*AdaIN .*config"):
        build(tmp_path / "other.pth", "16x16")
    file = write_fast_neural_style(tmp_path / "one.pth")
    state = torch.load(file)
    torch.save({name: state[name] for name in state if name != "in4.bias"}, file)
    with pytest.raises(CheckpointInvalid, match=r"missing: in4\.bias"):
        build(file, "16x16")
    folder = write_adain(tmp_path / "adain")
    (folder / "vgg_normalised.pth").unlink()
    with pytest.raises(CheckpointInvalid, match=r"vgg_normalised\.pth: is missing"):
        build(folder, "16x16", style=tmp_path / "style.png")


def test_the_command_names_the_network(tmp_path: Path) -> None:
    file = write_fast_neural_style(tmp_path / "mosaic.model", width=4, blocks=1)
    words = ["export", "stylise", "--checkpoint", str(file), "--size", "24x16"]
    words += ["-o", str(tmp_path / "mosaic.onnx"), "--level", "static"]
    completed = CliRunner().invoke(build_program(), words)
    assert completed.exit_code == 0, completed.output
    assert "fast neural style of width 4, 1 residual blocks" in completed.stderr

"""`stylise` against the same network written out in float64, and as a model."""

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.images import stylise_plugin as command
from gsgen.reference_plugins.images.stylise import Stylise, StyliseOptions
from gsgen.reference_plugins.loading.image_sizes import read_size
from gsgen.reference_plugins.synthetic import write_stylise
from gsgen.sdk.exporting.pipeline import Exported
from gsgen.sdk.exporting.post_process_exporter import export_post_process
from support.models.captured import assert_captured


def oracle(state: dict[str, torch.Tensor], blocks: int, image: torch.Tensor) -> torch.Tensor:
    w = {name: value.double() for name, value in state.items()}

    def block(name: str, x: torch.Tensor, stride: int = 1) -> torch.Tensor:
        weight = w[f"{name}.conv.weight"]
        x = F.pad(x, (weight.shape[-1] // 2,) * 4, mode="replicate")
        x = F.conv2d(x, weight, w[f"{name}.conv.bias"], stride=stride)
        mean, spread = (x.mean((2, 3), keepdim=True), x.var((2, 3), keepdim=True, correction=0))
        x = (x - mean) / torch.sqrt(spread + 1e-5)
        return x * w[f"{name}.norm.weight"][:, None, None] + w[f"{name}.norm.bias"][:, None, None]

    h, width = image.shape[2:]
    x = F.pad(2 * image.double() - 1, (0, -width % 4, 0, -h % 4), mode="replicate")
    for index, stride in enumerate((1, 2, 2)):
        x = block(f"down.{index}", x, stride).clamp(min=0)
    for index in range(blocks):
        inner = block(f"middle.{index}.first", x).clamp(min=0)
        x = x + block(f"middle.{index}.second", inner)
    for index in range(2):
        x = x.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
        x = block(f"up.{index}", x).clamp(min=0)
    x = F.conv2d(F.pad(x, (4,) * 4, mode="replicate"), w["last.weight"], w["last.bias"])
    return torch.sigmoid(x)[:, :, :h, :width]


@pytest.mark.parametrize("seed", range(4))
def test_network_agrees_with_its_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    options = StyliseOptions(2 * int(rng.integers(1, 5)), int(rng.integers(0, 4)))
    size = (int(rng.integers(9, 30)), int(rng.integers(9, 30)))
    torch.manual_seed(seed)
    network, image = Stylise(options, size).eval(), torch.rand(1, 3, *size)
    expected = oracle(network.state_dict(), options.blocks, image)
    with torch.no_grad():
        torch.testing.assert_close(network(image).double(), expected, atol=2e-5, rtol=0)
        half = network(image, torch.tensor([0.5])).double()
        torch.testing.assert_close(half, (expected + image) / 2, atol=2e-5, rtol=0)
        torch.testing.assert_close(network(image, torch.zeros(1)), image)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    folder = tmp_path_factory.mktemp("stylise")
    model = command.build(write_stylise(folder, channels=4, blocks=1), size="24x16")
    settings = Settings(level=Level.LIVE)
    return export_post_process(model, folder / "stylise.onnx", target="webgpu", settings=settings)


def test_styliser_runs_in_webgpu_without_stale_replays(exported: Exported) -> None:
    assert_captured(exported.report)


def test_the_manifest_has_the_image_and_the_slider(exported: Exported) -> None:
    image, slider = exported.manifest.inputs
    assert (image.role, image.shape, image.range) == ("image", (1, 3, 16, 24), (0.0, 1.0))
    assert (slider.role, slider.range, slider.default) == ("control", (0.0, 1.0), 1.0)
    assert exported.contents == "an image of 16 × 24 (height × width), float32"


@pytest.mark.parametrize("word", ["", "12", "0x3", "3x-1", "12 x 3", "anything"])
def test_invalid_size_is_refused(word: str) -> None:
    with pytest.raises(GsgenError, match="is not an image size"):
        read_size(word)


def test_sizes_are_parsed(tmp_path: Path) -> None:
    assert read_size("1024X576") == (576, 1024)
    assert read_size("any") is None
    network = command.build(write_stylise(tmp_path), size="any", slider=False)
    assert [(declared.role, declared.shape) for declared in network.inputs] == [("image", None)]

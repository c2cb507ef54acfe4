"""Checkpoints of Difix: what was trained on top of a network, against its branches spelled out."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from PIL import Image
from torch import nn

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.formats import write_ply
from gsgen.reference_plugins.images import denoiser_plugin as command
from gsgen.reference_plugins.images.denoiser import Denoiser, Step
from gsgen.reference_plugins.images.diffusion_checkpoint import read_diffusion
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.safetensors import read_safetensors, write_safetensors
from gsgen.reference_plugins.synthetic import torus_knot, write_denoiser, write_difix
from gsgen.sdk.exporting.post_process_exporter import export_post_process
from support.commands import gsgen_here

pytestmark = pytest.mark.slow


OPTIONS = {
    "_class_name": "UNet2DConditionModel",
    "block_out_channels": [8, 8],
    "down_block_types": ["CrossAttnDownBlock2D", "DownBlock2D"],
    "up_block_types": ["UpBlock2D", "CrossAttnUpBlock2D"],
    "cross_attention_dim": 6,
    "attention_head_dim": 2,
}
# Layers of the decoder that Difix gives a LoRA, one of each kind; and α/r of them.
LAYERS = (
    "decoder.conv_in",
    "decoder.mid_block.attentions.0.to_out.0",
    "decoder.up_blocks.0.upsamplers.0.conv",
    "decoder.up_blocks.1.resnets.0.conv_shortcut",
    "decoder.conv_out",
)
RANK, SHARE = 4, 8 / 4
# From the level of the encoder that a skip connection comes from, to that of the decoder: channels
# 4 and 8, coarsest first.
SKIPS = ((4, 8), (4, 8))
TIMESTEP = 199
WEIGHTS = "diffusion_pytorch_model.safetensors"


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_denoiser(tmp_path_factory.mktemp("base"), OPTIONS, latent=True)


@pytest.fixture(scope="module")
def change(base: Path) -> dict[str, Any]:
    """What the file holds, named as peft names what it wraps."""
    coder = read_diffusion(base).autoencoder
    assert coder is not None
    torch.manual_seed(5)
    vae = {}
    for name in LAYERS:
        weight = coder.get_submodule(name).weight
        assert isinstance(weight, torch.Tensor)
        vae |= _random_lora_weights(name, weight.shape)
    for index, (inputs, outputs) in enumerate(SKIPS):
        name = f"decoder.skip_conv_{index + 1}"
        vae[f"{name}.base_layer.weight"] = 0.3 * torch.randn(outputs, inputs, 1, 1)
        vae |= _random_lora_weights(name, torch.Size([outputs, inputs, 1, 1]))
    unet = read_safetensors(base / "unet" / WEIGHTS)
    return {
        "vae_lora_target_modules": list(LAYERS),
        "rank_vae": RANK,
        "state_dict_unet": {n: v + 0.02 * torch.randn_like(v) for n, v in unet.items()},
        "state_dict_vae": vae,
        "optimizer": {"state": {0: {"step": torch.tensor(1.0)}}, "param_groups": [{}]},
    }


def _random_lora_weights(name: str, shape: torch.Size) -> dict[str, torch.Tensor]:
    kernel = (1, 1) if len(shape) == 4 else ()
    return {
        f"{name}.lora_A.vae_skip.weight": 0.3 * torch.randn(RANK, *shape[1:]),
        f"{name}.lora_B.vae_skip.weight": 0.3 * torch.randn(shape[0], RANK, *kernel),
    }


def reference_output(base: Path, change: dict[str, Any], gamma: float = 1.0) -> torch.Tensor:
    """One step with the networks of ``base``, every branch of Difix beside them."""
    read = read_diffusion(base)
    unet, coder = read.unet, read.autoencoder
    assert coder is not None
    assert read.noise is not None
    state = unet.state_dict()
    state |= {n: v for n, v in change["state_dict_unet"].items() if "lora" not in n}
    unet.load_state_dict(state)
    vae = change["state_dict_vae"]
    for name in LAYERS:
        layer = coder.get_submodule(name)
        layer.register_forward_hook(_branch(vae, name))
    recorded_inputs: list[torch.Tensor] = []
    for level in coder.encoder.down_blocks:
        level.register_forward_pre_hook(lambda _, inputs: recorded_inputs.append(inputs[0]))

    def skip(index: int) -> Callable:
        name = f"decoder.skip_conv_{index + 1}"
        kernel = vae[f"{name}.base_layer.weight"]

        def add(_: nn.Module, inputs: tuple) -> torch.Tensor:
            features = gamma * recorded_inputs[len(recorded_inputs) - 1 - index]
            out = F.conv2d(features, kernel)
            return inputs[0] + _branch(vae, name)(nn.Conv2d(1, 1, 1), (features,), out)

        return add

    for index, level in enumerate(coder.decoder.up_blocks):
        level.register_forward_pre_hook(skip(index))
    latent, _ = coder.encode(image())
    noise = unet(latent, torch.tensor([float(TIMESTEP)]), prompt(base))
    signal = read.noise.signal[TIMESTEP]
    clean = (latent - (1 - signal).sqrt() * noise) / signal.sqrt()
    return coder.decode(clean.float()).clamp(-1, 1)


def _branch(vae: dict[str, torch.Tensor], name: str) -> Callable:
    down, up = (vae[f"{name}.lora_{part}.vae_skip.weight"] for part in "AB")

    def add(layer: nn.Module, inputs: tuple, out: torch.Tensor) -> torch.Tensor:
        if down.ndim == 2:
            return out + SHARE * (inputs[0] @ down.T) @ up.T
        pad = layer.padding if isinstance(layer, nn.Conv2d) else 0
        return out + SHARE * F.conv2d(F.conv2d(inputs[0], down, padding=pad), up)

    return add


def image() -> torch.Tensor:
    return torch.rand(1, 3, 12, 16, generator=torch.Generator().manual_seed(0)) - 0.5


def prompt(base: Path) -> torch.Tensor:
    with np.load(base / "prompt_embeds.npz") as arrays:
        return torch.from_numpy(arrays["encoder_hidden_states"])


def saved(change: dict[str, Any], folder: Path) -> Path:
    torch.save(change, folder / "model.pkl")
    return folder / "model.pkl"


def stepped(base: Path, **options: Any) -> torch.Tensor:
    read = read_diffusion(base, **options)
    return Denoiser(read, Step(timestep=TIMESTEP, size=(12, 16)), prompt(base))(image())


# ===== What it gives


def test_the_file_that_training_wrote_is_the_network_with_its_branches(
    base: Path, change: dict[str, Any], tmp_path: Path
) -> None:
    path = saved(change, tmp_path)
    actual, expected = stepped(base, difix=path), reference_output(base, change)
    torch.testing.assert_close(actual, expected, atol=2e-5, rtol=0)
    assert (actual - stepped(base)).abs().max() > 0.1
    read = read_diffusion(base, difix=path)
    assert "autoencoder with skip connections" in read.describe()
    assert read.added == (f"model.pkl × 1 in {len(LAYERS) + len(SKIPS)} layers, α/r 2",)


def published(base: Path, change: dict[str, Any], folder: Path, **config: Any) -> Path:
    """Write the folder that is published: an autoencoder saved as peft has wrapped it."""
    vae = read_safetensors(base / "vae" / WEIGHTS)
    wrapped = {f"{name}.": f"{name}.base_layer." for name in LAYERS}
    for before, after in wrapped.items():
        vae = {
            f"{after}{n.removeprefix(before)}" if n.startswith(before) else n: value
            for n, value in vae.items()
        }
    assert "decoder.conv_in.base_layer.bias" in vae
    write_safetensors(folder / "vae" / WEIGHTS, vae | change["state_dict_vae"])
    hub_config = json.loads((base / "vae" / "config.json").read_text())
    (folder / "vae" / "config.json").write_text(
        json.dumps(hub_config | {"lora_rank": RANK, "gamma": 1.0, "ignore_skip": False} | config)
    )
    write_safetensors(folder / "unet" / WEIGHTS, change["state_dict_unet"])
    for name in ("unet/config.json", "scheduler/scheduler_config.json"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes((base / name).read_bytes())
    (folder / "prompt_embeds.npz").write_bytes((base / "prompt_embeds.npz").read_bytes())
    return folder


@pytest.mark.parametrize("gamma", [1.0, 0.5])
def test_the_published_folder_gives_the_same(
    gamma: float, base: Path, change: dict[str, Any], tmp_path: Path
) -> None:
    actual = stepped(published(base, change, tmp_path, gamma=gamma))
    torch.testing.assert_close(actual, reference_output(base, change, gamma), atol=2e-5, rtol=0)


def test_a_unet_may_be_given_in_part(base: Path, change: dict[str, Any], tmp_path: Path) -> None:
    """As img2img-turbo does: one layer as it is, and a LoRA for others."""
    whole = read_safetensors(base / "unet" / WEIGHTS)
    name = "mid_block.resnets.0.conv1"
    thinned = _random_lora_weights(name, whole[f"{name}.weight"].shape)
    down, up = thinned.values()
    part = {"conv_in.weight": whole["conv_in.weight"] * 2} | {
        key.replace("vae_skip", "default"): value for key, value in thinned.items()
    }
    merged = whole[f"{name}.weight"] + SHARE * torch.einsum("orxy,rihw->oihw", up, down)
    names = {"conv_in.weight": part["conv_in.weight"], f"{name}.weight": merged}
    actual = stepped(base, difix=saved(change | {"state_dict_unet": part}, tmp_path))
    expected = reference_output(base, change | {"state_dict_unet": names})
    torch.testing.assert_close(actual, expected, atol=2e-5, rtol=0)


# ===== What is refused


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda c: c.pop("state_dict_vae"), "(?s)expected state_dict_unet and.*--lora FILE"),
        (lambda c: c["state_dict_vae"].update(x=torch.ones(1)), "unexpected: x"),
        (
            lambda c: c["state_dict_vae"].pop("decoder.skip_conv_2.base_layer.weight"),
            r"missing: decoder\.skip_conv_2\.weight",
        ),
        (
            lambda c: c["state_dict_vae"].update(
                _random_lora_weights("decoder.no", torch.Size([1, 1]))
            ),
            r"decoder\.no is not a layer",
        ),
        (
            lambda c: c["state_dict_vae"].pop("decoder.conv_in.lora_B.vae_skip.weight"),
            r"decoder\.conv_in has no lora_B",
        ),
    ],
)
def test_files_that_do_not_fit_are_refused(
    edit: Callable, words: str, base: Path, change: dict[str, Any], tmp_path: Path
) -> None:
    copied = change | {"state_dict_vae": dict(change["state_dict_vae"])}
    edit(copied)
    with pytest.raises(CheckpointInvalid, match=words):
        read_diffusion(base, difix=saved(copied, tmp_path))


def test_incompatible_networks_are_refused(
    base: Path, change: dict[str, Any], tmp_path: Path
) -> None:
    path = saved(change, tmp_path)
    with pytest.raises(CheckpointInvalid, match=r"(?s)the checkpoint has no vae/.*--vae DIR"):
        read_diffusion(base / "unet", difix=path)
    with pytest.raises(CheckpointInvalid, match=r"(?s)is a safetensors file.*--lora"):
        read_diffusion(base, difix=base / "vae" / WEIGHTS)
    without_branches = published(base, change, tmp_path / "run", ignore_skip=True)
    with pytest.raises(CheckpointInvalid, match="ignore_skip is true"):
        read_diffusion(without_branches)


# ===== From a checkpoint to pictures


def test_artifacts_are_removed_and_edges_stay(tmp_path: Path) -> None:
    """The synthetic checkpoint does what it says, through every part of Difix that it has."""
    run = write_difix(tmp_path)
    model = command.build(run, difix=run / "model.pkl", size="32x32", values="unit")
    step = (torch.arange(32) >= 16).float().expand(1, 3, 32, 32)  # an edge between blocks
    torch.testing.assert_close(model(step), step, atol=2e-3, rtol=0)
    small = 0.03 * torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    artifacts = 0.5 + F.interpolate(small, scale_factor=2)
    before, after = ((picture - 0.5).square().mean() for picture in (artifacts, model(artifacts)))
    assert after < 0.6 * before
    without = command.build(run, size="32x32", values="unit")  # sd-turbo alone
    assert (without(step) - step).abs().max() > 0.1


def test_picture_is_processed_in_float16_and_in_tiles(tmp_path: Path) -> None:
    run, path = write_difix(tmp_path / "run"), tmp_path / "enhance.onnx"
    model = command.build(run, difix=run / "model.pkl", size="16x16", values="unit")
    static = Settings(level=Level.STATIC)
    exported = export_post_process(model, path, dtype="float16", target="webgpu", settings=static)
    assert [declared.role for declared in exported.manifest.inputs] == [
        "image"
    ]  # the timestep is fixed
    write_ply(tmp_path / "knot.ply", torus_knot(2000))
    view = ("--width=24", "--height=24", "--camera=orbit:20,30", "--background=#16181d")
    for name, words in (("before", ()), ("after", ("--post", path))):
        result = gsgen_here(
            "render", tmp_path / "knot.ply", "-o", tmp_path / f"{name}.png", *view, *words
        )
        assert result.code == 0, result.err
    before, after = (
        np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB"), np.float32) / 255
        for name in ("before", "after")
    )
    # No part of the network looks farther than its neighbours, so it may see all at once, too.
    whole = command.build(run, difix=run / "model.pkl", size="24x24", values="unit")
    expected = whole(torch.from_numpy(before).permute(2, 0, 1)[None])[0].permute(1, 2, 0)
    np.testing.assert_allclose(after, expected.numpy(), atol=0.05)
    assert np.abs(after - expected.numpy()).mean() < 0.2 * np.abs(after - before).mean()

"""LoRA files: merged weights give what the network with its low-rank branches gives."""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.diffusion.lora import Adapter, merge, read_lora, split_pairs
from gsgen.reference_plugins.diffusion.lora_homes import layers_by_name
from gsgen.reference_plugins.diffusion.unet import UNet
from gsgen.reference_plugins.images import denoiser_plugin as command
from gsgen.reference_plugins.images.diffusion_checkpoint import read_diffusion
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.safetensors import read_metadata, write_safetensors
from gsgen.reference_plugins.synthetic import write_denoiser

OPTIONS = {
    "_class_name": "UNet2DConditionModel",
    "block_out_channels": [4, 8],
    "down_block_types": ["DownBlock2D", "CrossAttnDownBlock2D"],
    "up_block_types": ["CrossAttnUpBlock2D", "UpBlock2D"],
    "layers_per_block": 2,
    "norm_num_groups": 2,
    "cross_attention_dim": 6,
    "attention_head_dim": 2,
}
# One of each kind of layer: matrices, kernels of 1×1 and 3×3, a stride of two.
LAYERS = (
    "down_blocks.1.attentions.0.transformer_blocks.0.attn1.to_q",
    "down_blocks.1.attentions.1.transformer_blocks.0.attn2.to_out.0",
    "up_blocks.0.attentions.2.transformer_blocks.0.attn2.to_v",
    "mid_block.attentions.0.transformer_blocks.0.ff.net.0.proj",
    "down_blocks.1.attentions.0.proj_in",
    "down_blocks.0.downsamplers.0.conv",
    "down_blocks.0.resnets.1.conv1",
    "up_blocks.0.resnets.2.conv_shortcut",
    "up_blocks.0.upsamplers.0.conv",
    "mid_block.resnets.1.time_emb_proj",
    "conv_in",
)
ATTENTION = tuple(name for name in LAYERS if re.search(r"\.to_(q|k|v|out\.0)$", name))
RANK = 2

Thin = dict[str, tuple[torch.Tensor, torch.Tensor]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_denoiser(tmp_path_factory.mktemp("base"), OPTIONS)


def thin(unet: UNet, names: tuple[str, ...] = LAYERS, rank: int = RANK) -> Thin:
    """Matrices A and B for some layers, by the layers' names."""
    torch.manual_seed(3)
    tensors = {}
    for name in names:
        weight = unet.get_submodule(name).weight
        assert isinstance(weight, torch.Tensor)
        kernel = (1, 1) if weight.ndim == 4 else ()
        down = torch.randn(rank, *weight.shape[1:])
        tensors[name] = down, 0.3 * torch.randn(weight.shape[0], rank, *kernel)
    return tensors


def run_with_branches(unet: UNet, lora: Thin, shares: Mapping[str, float]) -> torch.Tensor:
    """What the network gives if each layer has a branch through A and B beside it."""
    hooks = [
        unet.get_submodule(name).register_forward_hook(_branch(*pair, shares[name]))
        for name, pair in lora.items()
    ]
    layers = given_by(unet)
    for hook in hooks:
        hook.remove()
    return layers


def _branch(down: torch.Tensor, up: torch.Tensor, share: float) -> Callable:
    def add(layer: nn.Module, inputs: tuple, out: torch.Tensor) -> torch.Tensor:
        if isinstance(layer, nn.Conv2d):
            change = F.conv2d(inputs[0], down, stride=layer.stride, padding=layer.padding)
            return out + share * F.conv2d(change, up)
        return out + share * (inputs[0] @ down.T) @ up.T

    return add


def given_by(unet: UNet) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    image = torch.randn(1, 4, 4, 6, generator=generator)
    return unet(
        image.to(unet.conv_in.weight.dtype),
        torch.tensor([30.0]),
        torch.randn(1, 3, 6, generator=generator),
    )


# ===== Names: those that the tools write


def _original(name: str) -> str:
    """The layer in the count of the original code, written out for this network by hand."""
    blocks = {
        "down_blocks.1.attentions.0": "input_blocks.4.1",
        "down_blocks.1.attentions.1": "input_blocks.5.1",
        "up_blocks.0.attentions.2": "output_blocks.2.1",
        "mid_block.attentions.0": "middle_block.1",
        "down_blocks.0.downsamplers.0.conv": "input_blocks.3.0.op",
        "down_blocks.0.resnets.1.conv1": "input_blocks.2.0.in_layers.2",
        "up_blocks.0.resnets.2.conv_shortcut": "output_blocks.2.0.skip_connection",
        "up_blocks.0.upsamplers.0.conv": "output_blocks.2.2.conv",
        "mid_block.resnets.1.time_emb_proj": "middle_block.2.emb_layers.1",
        "conv_in": "input_blocks.0.0",
    }
    (block,) = (key for key in blocks if name == key or name.startswith(f"{key}."))
    return blocks[block] + name.removeprefix(block)


def _processor(name: str) -> str:
    block, layer = re.fullmatch(r"(.*)\.(to_q|to_k|to_v|to_out)(?:\.0)?", name).groups()  # type: ignore[union-attr]
    return f"{block}.processor.{layer}_lora"


def _kohya(name: str) -> str:
    return "lora_unet_" + name.replace(".", "_")


# Style → its name for A and B of a layer, and the layers that it has names for.
STYLES: dict[str, tuple[Callable[[str], tuple[str, str]], tuple[str, ...]]] = {
    "peft": (lambda n: (f"base_model.model.{n}.lora_A.weight", f"base_model.model.{n}.lora_B.weight"), LAYERS),
    "peft, adapter": (lambda n: (f"{n}.lora_A.default.weight", f"{n}.lora_B.default.weight"), LAYERS),
    "diffusers": (lambda n: (f"unet.{n}.lora_A.weight", f"unet.{n}.lora_B.weight"), LAYERS),
    "diffusers, older": (lambda n: (f"unet.{n}.lora.down.weight", f"unet.{n}.lora.up.weight"), LAYERS),
    "processors": (lambda n: (f"unet.{_processor(n)}.down.weight", f"unet.{_processor(n)}.up.weight"), ATTENTION),
    "processors alone": (lambda n: (f"{_processor(n)}.down.weight", f"{_processor(n)}.up.weight"), ATTENTION),
    "kohya": (lambda n: (f"{_kohya(n)}.lora_down.weight", f"{_kohya(n)}.lora_up.weight"), LAYERS),
    "kohya, original": (lambda n: (f"{_kohya(_original(n))}.lora_down.weight", f"{_kohya(_original(n))}.lora_up.weight"), LAYERS),
    "original": (lambda n: (f"diffusion_model.{_original(n)}.lora_down.weight", f"diffusion_model.{_original(n)}.lora_up.weight"), LAYERS),
}  # fmt: skip


def lora_tensors(lora: Thin, style: str) -> dict[str, torch.Tensor]:
    names = STYLES[style][0]
    return {
        key: value
        for name, pair in lora.items()
        for key, value in zip(names(name), pair, strict=True)
    }


@pytest.mark.parametrize("style", STYLES)
def test_merged_weights_are_the_network_with_its_branches(
    style: str, run: Path, tmp_path: Path
) -> None:
    base = read_diffusion(run).unet
    lora = thin(base, STYLES[style][1])
    path = tmp_path / "style.safetensors"
    write_safetensors(path, lora_tensors(lora, style))
    read = read_diffusion(run, loras=[(path, 0.7)])
    shares = dict.fromkeys(lora, 0.7)  # without an α, α is the rank
    expected = run_with_branches(base, lora, shares)
    torch.testing.assert_close(given_by(read.unet), expected, atol=2e-5, rtol=2e-5)
    assert (expected - given_by(base)).abs().max() > 0.05
    assert read.added == (f"style.safetensors × 0.7 in {len(lora)} layers, α/r 1",)
    assert "style.safetensors × 0.7" in read.describe()
    assert read.digest != read_diffusion(run).digest


def _alpha_by_layer(lora: Thin) -> tuple[dict[str, torch.Tensor], dict[str, str], dict]:
    return {f"{_kohya(n)}.alpha": torch.tensor(i / 2) for i, n in enumerate(lora)}, {}, {}


def _alpha_by_config(lora: Thin) -> tuple[dict[str, torch.Tensor], dict[str, str], dict]:
    pattern = {"attn1.to_q": 5, "conv_in": 7}
    return ({}, {}, {"peft_type": "LORA", "r": RANK, "lora_alpha": 3, "alpha_pattern": pattern})


def _alpha_by_root(lora: Thin) -> tuple[dict[str, torch.Tensor], dict[str, str], dict]:
    peft_settings = {"unet.lora_alpha": 3, "unet.use_rslora": True, "unet.use_dora": False}
    return {}, {"lora_adapter_metadata": json.dumps(peft_settings)}, {}


@pytest.mark.parametrize(
    ("style", "extras", "share"),
    [
        ("kohya", _alpha_by_layer, lambda name: LAYERS.index(name) / 2 / RANK),
        ("peft", _alpha_by_config, lambda name: {LAYERS[0]: 5, "conv_in": 7}.get(name, 3) / RANK),
        ("diffusers", _alpha_by_root, lambda name: 3 / RANK**0.5),
    ],
)
def test_alpha_is_taken_from_where_the_tool_writes_it(
    style: str, extras: Callable, share: Callable, run: Path, tmp_path: Path
) -> None:
    base = read_diffusion(run).unet
    lora = thin(base)
    tensors, metadata, config = extras(lora)
    path = tmp_path / "adapter_model.safetensors"
    write_safetensors(path, lora_tensors(lora, style) | tensors, metadata)
    if config:
        (tmp_path / "adapter_config.json").write_text(json.dumps(config))
    assert read_metadata(path).items() >= metadata.items()
    read = read_diffusion(run, loras=[(tmp_path, 1.0)])  # the folder will do
    expected = run_with_branches(base, lora, {name: share(name) for name in lora})
    torch.testing.assert_close(given_by(read.unet), expected, atol=5e-5, rtol=2e-5)


def test_several_are_added_and_pickled_half_precision_ones_are_read(
    run: Path, tmp_path: Path
) -> None:
    base = read_diffusion(run).unet
    lora = {n: (a.half(), b.half()) for n, (a, b) in thin(base).items()}
    torch.save(lora_tensors(lora, "kohya"), tmp_path / "a.pt")
    write_safetensors(tmp_path / "b.safetensors", lora_tensors(lora, "peft"))
    read = read_diffusion(
        run, loras=[(tmp_path / "a.pt", 0.25), (tmp_path / "b.safetensors", -1.0)]
    )
    whole = {n: (a.float(), b.float()) for n, (a, b) in lora.items()}
    expected = run_with_branches(base, whole, dict.fromkeys(whole, -0.75))
    torch.testing.assert_close(given_by(read.unet), expected, atol=2e-5, rtol=2e-5)


def test_layers_of_the_autoencoder_have_names_too(tmp_path: Path) -> None:
    run = write_denoiser(tmp_path, OPTIONS, latent=True)
    base = read_diffusion(run).autoencoder
    assert base is not None
    name = "decoder.mid_block.attentions.0.to_out.0"
    weight = base.get_submodule(name).weight
    assert isinstance(weight, torch.Tensor)
    down, up = torch.randn(1, weight.shape[1]), torch.randn(weight.shape[0], 1)
    pair = {f"vae.{name}.lora_A.weight": down, f"vae.{name}.lora_B.weight": up}
    write_safetensors(tmp_path / "v.safetensors", pair)
    read = read_diffusion(run, loras=[(tmp_path / "v.safetensors", 1.0)]).autoencoder
    assert read is not None
    torch.testing.assert_close(read.get_submodule(name).weight, weight + up @ down)


def test_every_layer_goes_by_names_of_its_own(run: Path) -> None:
    read = read_diffusion(run)
    layers = [m for m in read.unet.modules() if isinstance(m, nn.Linear | nn.Conv2d)]
    layer_names = layers_by_name(read.unet, None)
    assert {id(layer_name) for layer_name in layer_names.values()} == {
        id(layer) for layer in layers
    }
    kohya = [name for name in layer_names if name.startswith("lora_unet_")]
    assert len(kohya) == 2 * len(layers)  # as diffusers and as the original code counts


# ===== Products


def _pairs() -> Iterator[tuple[nn.Module, int]]:
    for rank in (1, 3):
        yield nn.Linear(4, 6, bias=False), rank
        for kernel, stride in ((1, 1), (3, 1), (3, 2)):
            yield nn.Conv2d(4, 6, kernel, stride, padding=kernel // 2), rank


@settings(max_examples=25, deadline=None)
@given(
    case=st.sampled_from(list(_pairs())),
    scale=st.floats(-2, 2),
    alpha=st.one_of(st.none(), st.floats(0.125, 16)),
    flat=st.booleans(),
    seed=st.integers(0, 2**31),
)
def test_lora_products_equal_parallel_branches(
    case: tuple[nn.Module, int], scale: float, alpha: float | None, flat: bool, seed: int
) -> None:
    """Whatever the layer, and where a kernel of 1×1 is written as a matrix, or a matrix as one."""
    layer, rank = case
    torch.manual_seed(seed)
    weight = torch.randn(layer.weight.shape)  # type: ignore[arg-type, operator]
    layer.weight = nn.Parameter(weight)
    down, up = torch.randn(rank, *weight.shape[1:]), torch.randn(6, rank)
    if weight.ndim == 4 and not (flat and weight.shape[2] == 1):
        up = up[:, :, None, None]
    elif weight.ndim == 4:
        down = down.flatten(1)
    elif flat:
        down, up = down[:, :, None, None], up[:, :, None, None]
    state = {"layer.lora_down.weight": down, "layer.lora_up.weight": up}
    if alpha is not None:
        state["layer.alpha"] = torch.tensor([alpha], dtype=torch.float64)
    pairs, unpaired = split_pairs(state, Path("f"))
    assert not unpaired
    image = torch.randn(1, 4, 6, 6) if weight.ndim == 4 else torch.randn(5, 4)
    kernel = (rank, *weight.shape[1:]), (6, rank, *(1,) * (weight.ndim - 2))
    share = scale * (1 if alpha is None else alpha / rank)
    branch = _branch(down.reshape(kernel[0]), up.reshape(kernel[1]), share)
    expected = branch(layer, (image,), layer(image))
    merge(Adapter(path=Path("f"), pairs=pairs), scale, {"layer": layer})
    torch.testing.assert_close(layer(image), expected, atol=2e-3, rtol=1e-4)
    layer.weight = nn.Parameter(weight)


# ===== What is refused


def _edited(edit: str) -> tuple[dict[str, torch.Tensor], str]:
    first, two = torch.ones(2, 8), torch.ones(8, 2)
    name = f"unet.{ATTENTION[0]}"
    good = {f"{name}.lora_A.weight": first, f"{name}.lora_B.weight": two}
    down, up = good
    match edit:
        case "no such layer":
            extra = {f"{name}x.lora_A.weight": first, f"{name}x.lora_B.weight": two}
            return (
                good | extra,
                "1 of 2 LoRA layers do not fit.*to_qx is not a layer of the networks",
            )
        case "no partner":
            return {down: first}, "to_q has no lora_B or up"
        case "alpha alone":
            return good | {"lora_unet_conv_in.alpha": torch.ones(1)}, "conv_in has no lora_A"
        case "another shape":
            return good | {
                down: torch.ones(2, 9)
            }, r"\[8, 2\] × \[2, 9\], which does not fit the weight \[8, 8\]"
        case "another rank":
            return good | {down: torch.ones(3, 8)}, r"\[8, 2\] × \[3, 8\]"
        case "no rank":
            return {down: first[:0], up: two[:, :0]}, r"\[8, 0\] × \[0, 8\]"
        case "a number":
            return good | {down: torch.tensor(1.0)}, "does not fit the weight"
        case "two of them":
            return good | {f"{name}.lora_A.other.weight": first}, "second tensor of its kind"
        case "not finite":
            return good | {up: two * torch.nan}, "NaN or infinity"
        case "alpha of two numbers":
            return good | {f"{name}.alpha": torch.ones(2)}, r"alpha is \[2\], expected one"
        case "DoRA":
            extra = {f"{name}.lora_magnitude_vector": torch.ones(8)}
            return (good | extra, "(?s)1 tensors are not part of a LoRA.*DoRA is not supported")
        case "LoKr":
            return {"lora_unet_conv_in.lokr_w1": first}, "(?s)not part of a LoRA.*LoKr is not"
        case "a bias":
            return good | {f"{name}.lora_B.bias": torch.ones(8)}, r"lora_B\.bias"
        case "whole weights":
            return {f"{name}.weight": torch.ones(8, 8)}, "not part of a LoRA"
        case "text alone":
            return {"lora_te_text_model.lora_down.weight": first}, "0 of 0 LoRA layers"
    raise AssertionError(edit)


@pytest.mark.parametrize(
    "edit",
    [
        "no such layer", "no partner", "alpha alone", "another shape", "another rank", "no rank",
        "a number", "two of them", "not finite", "alpha of two numbers", "DoRA", "LoKr", "a bias",
        "whole weights", "text alone",
    ],
)  # fmt: skip
def test_unmatched_tensors_are_listed(edit: str, run: Path, tmp_path: Path) -> None:
    state, words = _edited(edit)
    write_safetensors(tmp_path / "l.safetensors", state)
    with pytest.raises(CheckpointInvalid, match=words):
        read_diffusion(run, loras=[(tmp_path / "l.safetensors", 1.0)])


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"use_dora": True}, "use_dora is True"),
        ({"fan_in_fan_out": True}, "fan_in_fan_out is True"),
        ({"peft_type": "LOHA"}, "peft_type is 'LOHA'"),
        ({"lora_alpha": "eight"}, "must hold finite numbers"),
        ({"alpha_pattern": {"a": None}}, "must hold finite numbers"),
        ({"alpha_pattern": {".*to_q": 2}}, "suffixes of layer names"),
    ],
)
def test_settings_of_another_network_are_refused(config: dict, words: str, tmp_path: Path) -> None:
    path = tmp_path / "adapter_model.safetensors"
    write_safetensors(path, _edited("no partner")[0])
    (tmp_path / "adapter_config.json").write_text(json.dumps(config))
    with pytest.raises(CheckpointInvalid, match=words):
        read_lora(path)


def test_damaged_metadata_and_folders_without_a_lora_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        CheckpointInvalid, match="holds no LoRA: expected one of pytorch_lora_weights"
    ):
        read_lora(tmp_path)
    (tmp_path / "text.pt").write_text("a page that says that the file has moved")
    with pytest.raises(CheckpointInvalid, match="cannot be read"):
        read_lora(tmp_path / "text.pt")
    with pytest.raises(CheckpointInvalid, match="is missing: a LoRA"):
        read_lora(tmp_path / "no.safetensors")
    path = tmp_path / "a.safetensors"
    for text, words in (("{", "is not valid JSON"), ("[]", "is not a JSON object")):
        write_safetensors(path, _edited("no partner")[0], {"lora_adapter_metadata": text})
        with pytest.raises(CheckpointInvalid, match=words):
            read_lora(path)


def test_text_encoder_parts_are_skipped_with_a_notice(run: Path, tmp_path: Path) -> None:
    state, _ = _edited("no partner")
    (down,) = state
    state |= {down.replace("_A", "_B"): torch.ones(8, 2)}
    for name in ("lora_te1_x.alpha", "text_encoder.x.lora_linear_layer.up.weight"):
        state[name] = torch.ones(1)
    write_safetensors(tmp_path / "l.safetensors", state)
    read = read_diffusion(run, loras=[(tmp_path / "l.safetensors", 1.0)])
    (warning,) = read.warnings
    assert "2 tensors are of the text encoder" in warning


# ===== The option


def test_the_option_says_file_and_scale(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "l.safetensors"
    write_safetensors(path, lora_tensors(thin(read_diffusion(run).unet), "peft"))
    clone = write_denoiser(tmp_path / "run", OPTIONS | {"in_channels": 3, "out_channels": 3})
    size = {"size": "8x8", "result": "network"}
    with pytest.raises(CheckpointInvalid, match=r"1 of 11 LoRA layers do not fit.*conv_in has"):
        command.build(clone, lora=[str(path)], **size)
    small = thin(read_diffusion(clone).unet)
    write_safetensors(path, lora_tensors(small, "peft"))
    image = torch.rand(1, 3, 8, 8)
    results = []
    for words in ([], [f"{path}:0.5", f"{path}:0.5"], [str(path)], [f"{path}:0"]):
        results.append(command.build(clone, lora=words, **size)(image))
    assert "l.safetensors × 0.5 in 11 layers" in capsys.readouterr().err
    torch.testing.assert_close(results[1], results[2], atol=1e-5, rtol=1e-5)
    assert torch.equal(results[0], results[3])
    assert not torch.allclose(results[0], results[2], atol=1e-2)
    odd = tmp_path / "a:2"
    path.rename(odd)
    assert torch.equal(command.build(clone, lora=[f"{odd}:1"], **size)(image), results[2])
    for text in ("inf", "0,5", ""):
        with pytest.raises(ConfigInvalid, match=f"'{text}' is not a scale"):
            command.build(clone, lora=[f"{odd}:{text}"], **size)
    with pytest.raises(CheckpointInvalid, match="b:c: is missing: a LoRA"):
        command.build(clone, lora=[str(tmp_path / "b:c")], **size)

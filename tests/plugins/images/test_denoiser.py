"""`denoiser` against the outputs of diffusers, and the closed form."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import diffusers
import numpy as np
import onnxruntime
import pytest
import torch

from gsgen.cli.commands.exporting.export_job import run_export
from gsgen.cli.commands.exporting.export_options import ExportRequest
from gsgen.contract.errors import ConfigInvalid, GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.images import denoiser_plugin as command
from gsgen.reference_plugins.images.denoiser import Denoiser, Step
from gsgen.reference_plugins.images.diffusion_checkpoint import read_diffusion
from gsgen.reference_plugins.images.embeddings import read_embeddings
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.safetensors import read_safetensors, write_safetensors
from gsgen.reference_plugins.synthetic import write_denoiser
from gsgen.sdk.exporting.pipeline import Exported
from gsgen.sdk.exporting.post_process_exporter import export_post_process
from support.commands import gsgen_here, shared
from support.models.captured import assert_captured

# One level: what is traced twice need not be large.
SMALL_UNET = {
    "block_out_channels": [8],
    "down_block_types": ["DownBlock2D"],
    "up_block_types": ["UpBlock2D"],
}
MAX_ERROR = 2e-5 / 3  # of the largest number, for one network
ONE_STEP = 5e-5 / 3  # for an encoder, a U-Net and a decoder after one another
CONDITIONAL = {
    "_class_name": "UNet2DConditionModel",
    "down_block_types": ["CrossAttnDownBlock2D", "DownBlock2D"],
    "up_block_types": ["UpBlock2D", "CrossAttnUpBlock2D"],
    "cross_attention_dim": 12,
    "attention_head_dim": 2,
}


def relative_error(actual: torch.Tensor, expected: np.ndarray | torch.Tensor) -> float:
    target = np.asarray(expected, np.float64)
    return float(np.abs(actual.double().numpy() - target).max() / np.abs(target).max())


def golden() -> Any:
    return np.load(shared("data/checkpoints/unet/golden.npz"))


# ===== The networks


def test_networks_agree_with_diffusers() -> None:
    saved, base = golden(), shared("data/checkpoints/unet/ckpt")
    run_folder, latent = read_diffusion(base / "uncond"), read_diffusion(base / "sdlike")
    with np.load(base / "sdlike" / "prompt_embeds.npz") as arrays:
        context = torch.from_numpy(arrays["encoder_hidden_states"])
    inputs = {key: torch.from_numpy(saved[f"in_{key}"]) for key in ("x", "x2", "z", "img")}
    for t in saved["in_timestep"]:
        moment = torch.tensor([float(t)])
        for key, name in (("x", "uncond"), ("x2", "uncond2")):
            assert (
                relative_error(run_folder.unet(inputs[key], moment), saved[f"out_{name}_t{t}"])
                <= MAX_ERROR
            )
        actual = latent.unet(inputs["z"], moment, context)
        assert relative_error(actual, saved[f"out_cond_t{t}"]) <= MAX_ERROR
    for t in (199, 999):
        step = Denoiser(latent, Step(timestep=float(t), size=(32, 32)), context)
        assert relative_error(step(inputs["img"]), saved[f"out_onestep_t{t}"]) <= ONE_STEP
        assert float(latent.noise.signal[t]) == pytest.approx(saved[f"aux_alphabar_t{t}"])


def predicted_by_diffusers(
    folder: Path, image: torch.Tensor, t: float, **conditioning: Any
) -> torch.Tensor:
    """Return what the U-Net of a folder predicts, read and called as users of diffusers do."""
    kind = json.loads((folder / "unet" / "config.json").read_text())["_class_name"]
    network = getattr(diffusers, kind).from_pretrained(folder / "unet", low_cpu_mem_usage=False)
    inputs = {name: value for name, value in conditioning.items() if value is not None}
    with torch.no_grad():
        return network(image, t, **inputs).sample


@pytest.mark.parametrize("seed", range(4))
def test_networks_of_any_shape_agree_with_those_that_diffusers_reads(
    seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    levels = int(rng.integers(1, 4))
    channels = [8 * int(n) for n in rng.integers(1, 4, levels)]
    attends = [bool(n) for n in rng.integers(0, 2, levels)]
    conditional = seed % 2 == 1
    word = "CrossAttn" if conditional else "Attn"
    options = (CONDITIONAL if conditional else {}) | {
        "block_out_channels": channels,
        "down_block_types": [f"{word if a else ''}DownBlock2D" for a in attends],
        "up_block_types": [f"{word if a else ''}UpBlock2D" for a in attends[::-1]],
        "layers_per_block": int(rng.integers(1, 3)),
        "norm_eps": float(rng.choice([1e-5, 1e-3])),
        "flip_sin_to_cos": bool(rng.integers(0, 2)),
        "freq_shift": int(rng.integers(0, 2)),
        "mid_block_scale_factor": float(rng.choice([1.0, 1.5])),
        "resnet_time_scale_shift": str(rng.choice(["default", "scale_shift"])),
        "use_linear_projection": bool(rng.integers(0, 2)),
    }
    if not conditional:
        options["attention_head_dim"] = [None, 4, 8][int(rng.integers(0, 3))]
    folder = write_denoiser(tmp_path, options, seed=seed)
    read = read_diffusion(folder)
    side = 2 ** (levels - 1)
    shape = (1, read.unet.options.inputs, side * int(rng.integers(1, 4)), side * 2)
    image = torch.from_numpy(rng.normal(size=shape).astype(np.float32))
    context = torch.randn(1, 3, 12) if conditional else None
    t = float(rng.integers(0, 1000))
    expected = predicted_by_diffusers(folder, image, t, encoder_hidden_states=context)
    assert relative_error(read.unet(image, torch.tensor([t]), context), expected) <= 1e-6


# SDXL in small: a vector of the prompt and six numbers about the image, of 4 features each.
XL = CONDITIONAL | {
    "down_block_types": ["DownBlock2D", "CrossAttnDownBlock2D"],
    "up_block_types": ["CrossAttnUpBlock2D", "UpBlock2D"],
    "attention_head_dim": 2,
    "use_linear_projection": True,
    "addition_embed_type": "text_time",
    "addition_time_embed_dim": 4,
    "projection_class_embeddings_input_dim": 10 + 6 * 4,
    "in_channels": 3,
    "out_channels": 3,
}


def encoded(path: Path, **arrays: Any) -> dict[str, torch.Tensor]:
    """Write what the text encoders of SDXL make of a prompt, and return it."""
    rng = np.random.default_rng(1)
    rows = {
        "prompt_embeds": rng.normal(size=(1, 5, 12)).astype(np.float32),
        "pooled_prompt_embeds": rng.normal(size=(1, 10)).astype(np.float32),
    }
    np.savez(path, **rows, **arrays)
    return {name: torch.from_numpy(array) for name, array in rows.items()}


@pytest.mark.parametrize(
    ("options", "ids", "features"),
    [
        ({}, None, (6.0, 8.0, 0.0, 0.0, 6.0, 8.0)),
        ({}, "512,768,1,2,1024,1536", (512.0, 768.0, 1.0, 2.0, 1024.0, 1536.0)),
        ({"time_ids": np.array([[9, 8, 7, 6, 5, 4]])}, None, (9.0, 8.0, 7.0, 6.0, 5.0, 4.0)),
        ({"time_ids": np.zeros((1, 6))}, "1,2,3,4,5,6", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
    ],
)
def test_network_receives_pooled_prompt_and_image_conditioning(
    options: dict[str, Any], ids: str | None, features: tuple[float, ...], tmp_path: Path
) -> None:
    folder = write_denoiser(tmp_path, XL)
    prompt = encoded(folder / "prompt_embeds.npz", **options)
    actual = command.build(folder, size="8x6", result="network", timestep=30, time_ids=ids)
    image = torch.rand(1, 3, 6, 8)

    def expected(sizes: Sequence[float]) -> torch.Tensor:
        pooled, time_ids = prompt["pooled_prompt_embeds"], torch.tensor([sizes])
        return predicted_by_diffusers(
            folder, image, 30, encoder_hidden_states=prompt["prompt_embeds"],
            added_cond_kwargs={"text_embeds": pooled, "time_ids": time_ids},
        )  # fmt: skip

    assert relative_error(actual(image), expected(features)) <= 1e-6
    assert relative_error(actual(image), expected([n + 1 for n in features])) > 1e-3


def test_mismatched_conditioning_is_refused(tmp_path: Path) -> None:
    folder = write_denoiser(tmp_path, XL)
    path = folder / "prompt_embeds.npz"
    with pytest.raises(GsgenError, match=r"(?s)has the arrays.*needs prompt_embeds"):
        command.build(folder, size="8x6")  # that of a network without
    encoded(path, other=np.zeros(1))
    with pytest.raises(GsgenError, match=r"has the arrays .*other"):
        command.build(folder, size="8x6")
    encoded(path)
    with pytest.raises(GsgenError, match=r"(?s)from images of any size.*--time-ids HEIGHT"):
        command.build(folder, size="any")
    with pytest.raises(GsgenError, match=r"have 10 \+ 5 × 4 = 30 numbers, expected 34"):
        command.build(folder, size="8x6", time_ids="1,2,3,4,5")
    with pytest.raises(GsgenError, match="'1,two' is not a list of numbers"):
        command.build(folder, size="8x6", time_ids="1,two")
    path.unlink()
    with pytest.raises(
        GsgenError, match=r"takes conditioning \[1, L, 12\]; --embeddings is missing"
    ):
        command.build(folder, size="8x6")
    run_folder = write_denoiser(tmp_path / "plain")
    with pytest.raises(GsgenError, match="takes no time_ids"):
        command.build(run_folder, time_ids="1,2,3,4,5,6")


@pytest.mark.parametrize("prediction", ["epsilon", "v_prediction", "sample"])
def test_noise_is_removed_by_the_closed_form(prediction: str, tmp_path: Path) -> None:
    schedule = {"prediction_type": prediction, "beta_schedule": "linear"}
    read = read_diffusion(write_denoiser(tmp_path, schedule=schedule))
    t, x = 300, torch.rand(1, 3, 8, 8) * 2 - 1
    signal = np.cumprod(1 - np.linspace(0.00085, 0.012, 1000))[t]
    raw = Denoiser(read, Step(timestep=t, size=(8, 8), returns_prediction=True))(x).double()
    expected = {
        "epsilon": (x - np.sqrt(1 - signal) * raw) / np.sqrt(signal),
        "v_prediction": np.sqrt(signal) * x - np.sqrt(1 - signal) * raw,
        "sample": raw,
    }[prediction].clamp(-1, 1)
    actual = Denoiser(read, Step(timestep=t, size=(8, 8)))(x)
    torch.testing.assert_close(actual.double(), expected, atol=2e-6, rtol=0)
    steered_model = Denoiser(read, Step(timestep=0, size=(8, 8), timestep_is_input=True))
    torch.testing.assert_close(
        steered_model(x, torch.tensor([float(t)])), actual, atol=2e-6, rtol=0
    )
    unit = Denoiser(read, Step(timestep=t, size=(8, 8), is_unit_range=True))
    torch.testing.assert_close(unit(x / 2 + 0.5), actual / 2 + 0.5, atol=2e-6, rtol=0)


def test_sides_that_are_no_multiples_are_continued_by_their_edge(tmp_path: Path) -> None:
    read = read_diffusion(write_denoiser(tmp_path, latent=True))
    assert read.stride == 4
    x = torch.rand(1, 3, 9, 6)
    padded = torch.nn.functional.pad(x, (0, 2, 0, 3), mode="replicate")
    expected = Denoiser(read, Step(timestep=100, size=(12, 8)))(padded)[:, :, :9, :6]
    torch.testing.assert_close(Denoiser(read, Step(timestep=100, size=(9, 6)))(x), expected)
    torch.testing.assert_close(Denoiser(read, Step(timestep=100))(x), expected)


# ===== Files


def test_safetensors_come_back_as_they_were(tmp_path: Path) -> None:
    tensors = {
        "a": torch.randn(2, 3),
        "b": torch.arange(5),
        "c": torch.randn(4).to(torch.bfloat16),
        "d": torch.zeros(0, 2),
        "e": torch.tensor(True),
    }
    write_safetensors(tmp_path / "t.safetensors", tensors)
    read = read_safetensors(tmp_path / "t.safetensors")
    assert sorted(read) == sorted(tensors)
    for name, value in tensors.items():
        assert read[name].dtype == value.dtype
        torch.testing.assert_close(read[name], value, rtol=0, atol=0)


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff" * 8, b"\2\0\0\0\0\0\0\0[]", b"\4\0\0\0\0\0\0\0nope"],
    ids=["empty", "long", "list", "text"],
)
def test_damaged_safetensors_are_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "t.safetensors"
    path.write_bytes(data)
    with pytest.raises(CheckpointInvalid, match="cannot be read"):
        read_safetensors(path)


@pytest.mark.parametrize("field", ["shape", "data_offsets", "dtype"])
def test_tensors_that_do_not_fit_their_bytes_are_refused(field: str, tmp_path: Path) -> None:
    wrong = {"shape": [-1, -4], "data_offsets": [0, 99], "dtype": "F8_E4M3"}
    reason = {"shape": "integer `-1`"}.get(field, "invalid shape, data type, or offset for tensor")
    entry = {"dtype": "F32", "shape": [4], "data_offsets": [0, 16]} | {field: wrong[field]}
    text = json.dumps({"a": entry}).encode()
    path = tmp_path / "t.safetensors"
    path.write_bytes(len(text).to_bytes(8, "little") + text + bytes(16))
    with pytest.raises(CheckpointInvalid, match=f"cannot be read: .*{reason}"):
        read_safetensors(path)


def test_pickled_weights_and_old_names_are_read(tmp_path: Path) -> None:
    folder = write_denoiser(tmp_path)
    path = folder / "unet" / "diffusion_pytorch_model.safetensors"
    state = read_safetensors(path)
    x, moment = torch.randn(1, 3, 8, 8), torch.tensor([7.0])
    expected = read_diffusion(folder).unet(x, moment)
    old = {"to_q": "query", "to_k": "key", "to_v": "value", "to_out.0": "proj_attn"}
    renamed = {}
    for name, value in state.items():
        for new, before in old.items():
            name = name.replace(f".{new}.", f".{before}.")
        renamed[name] = value
    path.unlink()
    torch.save(renamed, path.with_suffix(".bin"))
    torch.testing.assert_close(read_diffusion(folder).unet(x, moment), expected)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("_class_name", "DiTTransformer2DModel", "supported"),
        ("act_fn", "mish", "supported"),
        ("down_block_types", ["SkipDownBlock2D", "DownBlock2D"], "SkipDownBlock2D"),
        ("norm_num_groups", 5, "does not describe a valid network"),
        ("block_out_channels", [8], "list of 1 block types"),
        ("block_out_channels", [8, 32], "expected"),
        ("layers_per_block", "two", "an integer of at least 1"),
        ("class_embed_type", "timestep", "supported"),
    ],
)
def test_networks_of_another_kind_are_refused(
    option: str, value: object, message: str, tmp_path: Path
) -> None:
    folder = write_denoiser(tmp_path)
    path = folder / "unet" / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {option: value}))
    with pytest.raises(CheckpointInvalid, match=message):
        read_diffusion(folder)


def test_weights_that_are_missing_are_named(tmp_path: Path) -> None:
    folder = write_denoiser(tmp_path)
    path = folder / "unet" / "diffusion_pytorch_model.safetensors"
    state = read_safetensors(path)
    del state["conv_in.bias"]
    write_safetensors(path, state | {"extra": torch.zeros(1)})
    with pytest.raises(CheckpointInvalid, match=r"missing: conv_in\.bias; unexpected: extra"):
        read_diffusion(folder)


def test_invalid_timesteps_are_refused(tmp_path: Path) -> None:
    run_folder = write_denoiser(tmp_path / "plain")
    with pytest.raises(GsgenError, match="is not a timestep: expected 0 to 999"):
        command.build(run_folder, timestep=1000.0)
    with pytest.raises(GsgenError, match="is not an image size"):
        command.build(run_folder, size="12x0")
    of_images = CONDITIONAL | {"in_channels": 3, "out_channels": 3}
    conditional = write_denoiser(tmp_path / "cond", of_images)
    (conditional / "prompt_embeds.npz").unlink()
    with pytest.raises(GsgenError, match="--embeddings"):
        command.build(conditional)
    with pytest.raises(GsgenError, match="--result network"):
        command.build(run_folder / "unet")
    latent = write_denoiser(tmp_path / "latent", {"in_channels": 5})
    with pytest.raises(GsgenError, match="5 channels"):
        command.build(latent)


# ===== The model


@pytest.fixture(scope="module")
def model_and_export(tmp_path_factory: pytest.TempPathFactory) -> tuple[Denoiser, Exported]:
    folder = tmp_path_factory.mktemp("denoiser")
    model = command.build(write_denoiser(folder), timestep_input=True)
    path = folder / "denoiser.onnx"
    settings = Settings(level=Level.LIVE)
    return model, export_post_process(model, path, target="webgpu", settings=settings)


def test_the_timestep_steers_the_model(model_and_export: tuple[Denoiser, Exported]) -> None:
    model, exported = model_and_export
    session = onnxruntime.InferenceSession(exported.path)
    image = np.random.default_rng(0).uniform(-1, 1, (1, 3, 16, 16)).astype(np.float32)
    results = []
    for t in (0.0, 250.0, 999.0):
        feeds = {"image": image, "timestep": np.array([t], np.float32)}
        (result,) = session.run(None, feeds)
        expected = model(torch.from_numpy(image), torch.tensor([t]))
        np.testing.assert_allclose(result, expected.numpy(), atol=1e-4)
        results.append(result)
    assert np.abs(results[0] - results[1]).max() > 0.01


def test_the_manifest_declares_range_and_timestep(
    model_and_export: tuple[Denoiser, Exported],
) -> None:
    manifest = model_and_export[1].manifest
    assert manifest.kind == "post-process"
    assert manifest.image_range == manifest.outputs.image.range == (-1.0, 1.0)
    assert [declared.role for declared in manifest.inputs] == ["image", "timestep"]
    assert manifest.inputs[1].range == (0.0, 999.0)
    assert manifest.producer.weights_sha256 is not None


def test_denoiser_runs_in_webgpu_without_stale_replays(
    model_and_export: tuple[Denoiser, Exported],
) -> None:
    assert_captured(model_and_export[1].report)


@pytest.mark.slow
def test_half_precision_export_prints_size_and_agreement(tmp_path: Path) -> None:
    folder = write_denoiser(tmp_path / "run", SMALL_UNET)
    out = tmp_path / "clean.onnx"
    words = ("--level", "static", "--size", "12x8", "--dtype", "float16")
    completed = gsgen_here("export", "denoiser", "--checkpoint", folder, "-o", out, *words)
    assert completed.code == 0, completed.err
    assert "sides are multiples of 1" in completed.err
    assert "an image of 8 × 12 (height × width), float16" in completed.out
    assert "agrees with torch" in completed.out
    session = onnxruntime.InferenceSession(out)
    assert session.get_inputs()[0].type == session.get_outputs()[0].type == "tensor(float16)"
    image = np.random.default_rng(0).uniform(-1, 1, (1, 3, 8, 12)).astype(np.float16)
    (result,) = session.run(None, {"image": image})
    expected = command.build(folder, size="12x8")(torch.from_numpy(image).float()).numpy()
    np.testing.assert_allclose(result.astype(np.float32), expected, atol=0.02)
    weights = sum(value.numel() for value in read_diffusion(folder).unet.parameters())
    assert out.stat().st_size < 2 * weights + 100_000


def test_gaussian_options_are_refused_for_images(tmp_path: Path) -> None:
    out = tmp_path / "clean.onnx"
    model = command.build(write_denoiser(tmp_path, SMALL_UNET))
    with pytest.raises(ConfigInvalid, match="no Gaussians"):
        run_export(lambda: model, ExportRequest(output=out, capacity=3), "denoiser")
    assert not out.exists()


def test_a_network_on_latents_needs_its_autoencoder(tmp_path: Path) -> None:
    run = write_denoiser(tmp_path / "run", CONDITIONAL, latent=True)
    size: dict[str, Any] = {"size": "8x8", "embeddings": run / "prompt_embeds.npz"}
    with pytest.raises(ConfigInvalid, match="4 channels works on latents") as caught:
        command.build(run / "unet", result="network", **size)
    assert "--vae DIR" in str(caught.value)
    whole = command.build(run, **size)
    (tmp_path / "other").mkdir()
    (run / "vae").rename(tmp_path / "other" / "vae")
    for vae in (tmp_path / "other", tmp_path / "other" / "vae"):
        parted = command.build(run, vae=vae, **size)
        image = torch.rand(1, 3, 8, 8)
        assert torch.equal(parted(image), whole(image))


@pytest.mark.parametrize("cut", [0, 40, 200])
def test_a_damaged_conditioning_is_refused_by_its_name(cut: int, tmp_path: Path) -> None:
    path = tmp_path / "prompt.npz"
    np.savez_compressed(path, prompt_embeds=np.ones((1, 5, 4), np.float32))
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(CheckpointInvalid, match=r"prompt\.npz: cannot be read"):
        read_embeddings(path)
    np.savez(path, prompt_embeds=np.array(["a", "b"]))
    with pytest.raises(ConfigInvalid, match="prompt_embeds holds <U1, expected numbers"):
        read_embeddings(path)
    for count in (0, 2):
        np.savez(path, **{f"array_{index}": np.ones((1, 5, 4)) for index in range(count)})
        with pytest.raises(ConfigInvalid, match=f"has {count} arrays, expected one"):
            read_embeddings(path)

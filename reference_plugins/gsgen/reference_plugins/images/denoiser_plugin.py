"""The command `gsgen export denoiser`: exports one diffusion step as a post-process model."""

__all__ = ["PLUGIN"]

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.loading.image_sizes import read_size
from gsgen.reference_plugins.loading.options import note
from gsgen.sdk.plugins.plugin import Demo, Plugin

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from gsgen.reference_plugins.images.denoiser import Denoiser
    from gsgen.reference_plugins.images.diffusion_checkpoint import DiffusionCheckpoint
    from gsgen.reference_plugins.images.embeddings import Embeddings

_EMBEDDINGS_FILE = "prompt_embeds.npz"
_DEMO_TIMESTEP = 60

Folder = Annotated[
    Path,
    typer.Option(
        "--checkpoint", help="Folder with unet/, vae/ and scheduler/.", show_default=False
    ),
]
Vae = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the autoencoder, if it is not in DIR.", show_default="DIR/vae, if it exists"
    ),
]
Lora = Annotated[
    list[str] | None,
    typer.Option(
        "--lora",
        help="FILE[:SCALE]: add a LoRA to the weights, times SCALE (default 1). Repeat for several.",
        show_default="none",
    ),
]
DifixFile = Annotated[
    Path | None,
    typer.Option(
        "--difix",
        help="The model.pkl of Difix: its U-Net, LoRA and skip connections are added to those of DIR.",
        show_default="none",
    ),
]
Timestep = Annotated[float, typer.Option(help="Timestep of the denoising step.", min=0)]
ConditioningOption = Annotated[
    bool, typer.Option("--timestep-input", help="The timestep is an input of the model.")
]
SizeOption = Annotated[
    str | None,
    typer.Option(
        help="Image size as WIDTHxHEIGHT; or any, which prevents graph capture.",
        show_default="the size of training",
    ),
]
EmbeddingsFile = Annotated[
    Path | None,
    typer.Option(
        help="Embeddings of the prompt: npz with one array [1, L, D]; for SDXL with "
        "prompt_embeds, pooled_prompt_embeds and, to override the image size, time_ids.",
        show_default=f"DIR/{_EMBEDDINGS_FILE}",
    ),
]
TimeIds = Annotated[
    str | None,
    typer.Option(
        help="Image sizes for SDXL: height,width,top,left,height,width.",
        show_default="from the embeddings, or the image size",
    ),
]
Values = Annotated[
    Literal["signed", "unit"],
    typer.Option(help="Range of image values: −1 to 1 (signed), or 0 to 1 as in renderers (unit)."),
]
Result = Annotated[
    Literal["image", "network"],
    typer.Option(help="Output: the clean image, or the network's prediction."),
]


def build(
    checkpoint: Folder,
    vae: Vae = None,
    lora: Lora = None,
    difix: DifixFile = None,
    timestep: Timestep = 199.0,
    size: SizeOption = None,
    embeddings: EmbeddingsFile = None,
    time_ids: TimeIds = None,
    values: Values = "signed",
    result: Result = "image",
    *,
    timestep_input: ConditioningOption = False,
) -> "Denoiser":
    """Read a diffusion checkpoint, report its contents, and return the post-process model."""
    from importlib.metadata import version

    from gsgen.contract.spec.manifest import Producer
    from gsgen.reference_plugins.images.denoiser import Denoiser, Step
    from gsgen.reference_plugins.images.diffusion_checkpoint import read_diffusion

    requested_size = None if size is None else read_size(size)
    loras = [_parse_lora(word) for word in lora or ()]
    read = read_diffusion(checkpoint, vae, difix=difix, loras=loras)
    note(read.describe())
    for warning in read.warnings:
        note(f"warning: {warning}")
    image_size = _trained_size(read) if size is None else requested_size
    if image_size and (image_size[0] % read.stride or image_size[1] % read.stride):
        note(f"note: sides are not multiples of {read.stride}; images are padded by their edge")
    step = Step(
        timestep=timestep,
        timestep_is_input=timestep_input,
        size=image_size,
        is_unit_range=values == "unit",
        returns_prediction=result == "network",
    )
    prompt = _conditioning(read, checkpoint, embeddings)
    denoiser = Denoiser(
        read, step, prompt.context, _vector_input(read, prompt, time_ids, image_size)
    )
    denoiser.producer = Producer(f"gsgen {version('gsgen')}", weights_sha256=read.digest)
    return denoiser


def _parse_lora(word: str) -> tuple[Path, float]:
    """Parse the option ``FILE[:SCALE]`` of a LoRA; the default scale is 1."""
    name, colon, text = word.rpartition(":")
    if not colon or Path(word).exists():
        return Path(word), 1.0
    if text.strip("0123456789.,+-eE") not in ("", "inf", "nan"):
        return Path(word), 1.0  # the colon is part of the file name
    try:
        scale = float(text)
    except ValueError:
        scale = math.nan
    if not math.isfinite(scale):
        hint = "Write it as FILE or FILE:0.8."
        message = f"{text!r} is not a scale: expected a finite number"
        raise ConfigInvalid(message, where="--lora", hint=hint)
    return Path(name), scale


def _trained_size(read: "DiffusionCheckpoint") -> tuple[int, int]:
    if read.size is None:
        hint = "Give --size WIDTHxHEIGHT, or --size any."
        message = "the checkpoint does not record an image size"
        raise ConfigInvalid(message, where="--size", hint=hint)
    note(f"size: {read.size[0]} × {read.size[1]}, as in training")
    return read.size


def _conditioning(
    read: "DiffusionCheckpoint", folder: Path, embeddings: Path | None
) -> "Embeddings":
    """Read the prompt's embeddings from the given file, or from the checkpoint's folder."""
    from gsgen.reference_plugins.images.embeddings import Embeddings, read_embeddings

    default_path, options = folder / _EMBEDDINGS_FILE, read.unet.options
    if embeddings is None and (options.context is None or not default_path.is_file()):
        return Embeddings()
    path = embeddings or default_path
    prompt = read_embeddings(path, pooled=options.vector is not None)
    note(f"conditioning: {path}, {prompt.describe()}")
    return prompt


def _vector_input(
    read: "DiffusionCheckpoint", prompt: "Embeddings", ids: str | None, size: tuple[int, int] | None
) -> "Tensor | None":
    """Return the conditioning vector of SDXL: the pooled prompt embedding and image sizes."""
    from gsgen.reference_plugins.diffusion.unet import added_vector

    if read.unet.options.vector is None:
        if ids is not None:
            raise ConfigInvalid("the network takes no time_ids", where="--time-ids")
        return None
    if prompt.pooled is None:
        return None  # the error about missing embeddings covers this
    time_ids = prompt.time_ids if ids is None else _parse_numbers(ids)
    if time_ids is None:
        if size is None:
            hint = "Give --time-ids HEIGHT,WIDTH,0,0,HEIGHT,WIDTH."
            message = "time_ids cannot be derived from images of any size"
            raise ConfigInvalid(message, where="--time-ids", hint=hint)
        time_ids = (*map(float, size), 0.0, 0.0, *map(float, size))
        note(f"time_ids: {','.join(f'{time_id:g}' for time_id in time_ids)}, from the image size")
    try:
        return added_vector(prompt.pooled, time_ids, read.unet.options)
    except ValueError as error:
        message = f"the pooled prompt and time_ids do not fit the network: {error}"
        raise ConfigInvalid(message, where="--time-ids") from error


def _parse_numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or not all(map(math.isfinite, numbers)):
        hint = "Write them as 1024,1024,0,0,1024,1024."
        raise ConfigInvalid(f"{text!r} is not a list of numbers", where="--time-ids", hint=hint)
    return numbers


def _write_demo(folder: Path) -> list[str]:
    """Write a U-Net that removes fine noise, and return the options that export it."""
    from gsgen.reference_plugins.images.synthetic_images import write_denoiser

    unet = {"down_block_types": ["DownBlock2D"] * 2, "up_block_types": ["UpBlock2D"] * 2}
    write_denoiser(folder, unet | {"add_attention": False}, smoothing=True)
    step = ["--timestep", str(_DEMO_TIMESTEP), "--values", "unit"]
    return ["--checkpoint", str(folder), *step, "--size", "240x240"]


def _add_image_noise(picture: "np.ndarray") -> "np.ndarray":
    """Add diffusion noise to a uint8 image [H, W, 3], as a demonstration input for a denoiser."""
    import numpy as np

    from gsgen.reference_plugins.images.diffusers_writer import SCHEDULE

    first, last = math.sqrt(SCHEDULE["beta_start"]), math.sqrt(SCHEDULE["beta_end"])
    beta = np.linspace(first, last, SCHEDULE["num_train_timesteps"]) ** 2
    signal = float(np.prod(1 - beta[: _DEMO_TIMESTEP + 1]))
    noise = np.random.default_rng(0).normal(size=picture.shape)
    signed_image = math.sqrt(signal) * (picture / 127.5 - 1) + math.sqrt(1 - signal) * noise
    return (np.clip(0.5 * signed_image + 0.5, 0, 1) * 255 + 0.5).astype(np.uint8)


PLUGIN = Plugin(
    name="denoiser",
    words="diffusion difix sd-turbo sdxl unet stable-diffusion difix3d",
    summary="One step of a diffusion network that cleans the rendered image (post-process).",
    reads="Reads the layout of diffusers: DIR/unet/ and, for networks on latents, DIR/vae/, each "
    "with config.json and diffusion_pytorch_model.safetensors (or .bin), and "
    "DIR/scheduler/scheduler_config.json. The folder of a U-Net alone is accepted, too.",
    inputs=("image", "timestep"),
    demo=Demo(
        write=_write_demo,
        caption="a noisy rendered image, and its denoised version",
        degrade_image=_add_image_noise,
    ),
    build=build,
)

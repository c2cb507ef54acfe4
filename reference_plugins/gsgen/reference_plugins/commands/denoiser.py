"""`gsgen export denoiser`: one step of a diffusion network as a post-process model."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.commands.options import note
from gsgen.reference_plugins.commands.sizes import read_size
from gsgen.sdk.plugin import Plugin

if TYPE_CHECKING:
    from torch import Tensor

    from gsgen.reference_plugins.checkpoints.diffusion import DiffusionCheckpoint
    from gsgen.reference_plugins.denoiser import Denoiser

_EMBEDDINGS = "prompt_embeds.npz"

Folder = Annotated[
    Path,
    typer.Option(
        "--checkpoint", help="Folder with unet/, vae/ and scheduler/.", show_default=False
    ),
]
Vae = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the autoencoder, for a U-Net on latents that lies elsewhere.",
        show_default="DIR/vae, if it is there",
    ),
]
Timestep = Annotated[
    float, typer.Option(help="At which timestep the step is taken.", min=0)
]
Steers = Annotated[
    bool, typer.Option("--timestep-input", help="The timestep is an input of the model.")
]
Size = Annotated[
    str | None,
    typer.Option(
        help="Images as HEIGHTxWIDTH, or any: then the graph is not captured.",
        show_default="that of training",
    ),
]
Embeddings = Annotated[
    Path | None,
    typer.Option(
        help="What the text encoder makes of the prompt: npz with one array [1, L, D].",
        show_default=f"DIR/{_EMBEDDINGS}",
    ),
]
Values = Annotated[
    Literal["signed", "unit"],
    typer.Option(
        help="Black and white of images: −1 and 1, or 0 and 1 as renderers have them."
    ),
]
Result = Annotated[
    Literal["image", "network"],
    typer.Option(help="The clean image, or what the network itself predicts."),
]


def build(
    checkpoint: Folder,
    vae: Vae = None,
    timestep: Timestep = 199.0,
    timestep_input: Steers = False,
    size: Size = None,
    embeddings: Embeddings = None,
    values: Values = "signed",
    result: Result = "image",
) -> "Denoiser":
    """Read a checkpoint, say what is in it, and return its model."""
    from importlib.metadata import version

    from gsgen.contract.manifest import Producer
    from gsgen.reference_plugins.checkpoints.diffusion import read_diffusion
    from gsgen.reference_plugins.denoiser import Denoiser, Step

    given = None if size is None else read_size(size)
    read = read_diffusion(checkpoint, vae)
    note(read.describe())
    sides = _trained(read) if size is None else given
    if sides and (sides[0] % read.stride or sides[1] % read.stride):
        note(
            f"note: sides are no multiples of {read.stride}; images are continued by their edge"
        )
    step = Step(timestep, timestep_input, sides, values == "unit", result == "network")
    made = Denoiser(read, step, _context(read, checkpoint, embeddings))
    made.producer = Producer(f"gsgen {version('gsgen')}", weights_sha256=read.digest)
    return made


def _trained(read: "DiffusionCheckpoint") -> tuple[int, int]:
    if read.size is None:
        mend = "Give --size HEIGHTxWIDTH, or --size any."
        raise ConfigInvalid("the checkpoint tells no size", where="--size", mend=mend)
    note(f"size: {read.size[0]} × {read.size[1]}, that of training")
    return read.size


def _context(
    read: "DiffusionCheckpoint", folder: Path, embeddings: Path | None
) -> "Tensor | None":
    """Return the conditioning: of the file given, or of the one that lies in the folder."""
    import numpy as np
    import torch

    usual = folder / _EMBEDDINGS
    if embeddings is None and (read.unet.options.context is None or not usual.is_file()):
        return None
    path = embeddings or usual
    try:
        with np.load(path, allow_pickle=False) as arrays:
            names = list(arrays)
            if len(names) != 1:
                raise ValueError(f"has {len(names)} arrays, wanted one")
            found = np.asarray(arrays[names[0]], np.float32)
    except (OSError, ValueError, TypeError, EOFError) as error:
        what = f"cannot be read as npz: {error}"
        raise ConfigInvalid(what, where=str(path)) from error
    if not np.isfinite(found).all():
        raise ConfigInvalid("holds NaN or infinity", where=str(path))
    note(f"conditioning: {path}, {list(found.shape)}")
    return torch.from_numpy(found)


PLUGIN = Plugin(
    name="denoiser",
    summary="One step of a diffusion network that cleans the rendered image (post-process).",
    reads="Reads the layout of diffusers: DIR/unet/ and, for networks on latents, DIR/vae/, each "
    "with config.json and diffusion_pytorch_model.safetensors (or .bin), and "
    "DIR/scheduler/scheduler_config.json. A U-Net's own folder will do, too.",
    inputs=("image", "timestep"),
    build=build,
)

"""`gsgen export stylise`: a feed-forward stylisation network as a post-process model."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.reference_plugins.images.image_sizes import read_size
from gsgen.reference_plugins.loading.options import note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.images.stylise import Stylise

Folder = Annotated[
    Path,
    typer.Option(
        "--checkpoint", help="Folder of config.json and weights.", show_default=False
    ),
]
Size = Annotated[
    str,
    typer.Option(help="Images as HEIGHTxWIDTH, or any: then the graph is not captured."),
]
Slider = Annotated[
    bool,
    typer.Option("--slider/--no-slider", help="How much of the style shows is an input."),
]


def build(checkpoint: Folder, size: Size = "360x640", slider: Slider = True) -> "Stylise":
    """Read a checkpoint, say what is in it, and return its model."""
    import hashlib
    from importlib.metadata import version

    from gsgen.contract.spec.manifest import Producer
    from gsgen.reference_plugins.diffusion.model_config import read_model_config
    from gsgen.reference_plugins.images.stylise import Stylise, StyliseOptions
    from gsgen.reference_plugins.loading.safetensors import read_safetensors
    from gsgen.reference_plugins.loading.states import require_tensors

    sides = read_size(size)
    config = read_model_config(checkpoint)
    options = StyliseOptions(
        config.integer("channels", 16), config.integer("blocks", 3, least=0)
    )
    made = Stylise(options, sides, slider=slider)
    path = checkpoint / "stylise.safetensors"
    wanted = {name: tuple(value.shape) for name, value in made.state_dict().items()}
    made.load_state_dict(require_tensors(path, read_safetensors(path), wanted), strict=True)
    count = sum(weight.numel() for weight in made.parameters())
    note(f"{path}: {count:,} weights, {options.blocks} residual blocks")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    made.producer = Producer(f"gsgen {version('gsgen')}", weights_sha256=digest)
    return made


def _write_demo(folder: Path) -> list[str]:
    """Write a network that draws outlines."""
    from gsgen.reference_plugins.images.synthetic_images import write_stylise

    write_stylise(folder, drawing=True)
    return ["--checkpoint", str(folder), "--size", "240x240"]


PLUGIN = Plugin(
    name="stylise",
    summary="A feed-forward network that draws the rendered image in another style (post-process).",
    reads="Reads DIR/config.json (channels, blocks) and DIR/stylise.safetensors.",
    inputs=("image", "control"),
    publication=Publication(
        paper="Johnson et al. 2016",
        arxiv="1603.08155",
    ),
    demo=Demo(write=_write_demo, caption="a rendered image, and its drawing"),
    build=build,
)

"""The command `gsgen export stylise`: exports a style transfer network as post-process model."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.reference_plugins.loading.image_sizes import read_size
from gsgen.reference_plugins.loading.options import note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.images.stylise import Stylise

Folder = Annotated[
    Path,
    typer.Option(
        "--checkpoint", help="Folder with config.json and stylise.safetensors.", show_default=False
    ),
]
SizeOption = Annotated[
    str, typer.Option(help="Image size as HEIGHTxWIDTH; or any, which prevents graph capture.")
]
SliderOption = Annotated[
    bool,
    typer.Option("--slider/--no-slider", help="Declare the strength of the style as an input."),
]


def build(
    checkpoint: Folder, size: SizeOption = "360x640", *, slider: SliderOption = True
) -> "Stylise":
    """Read a style transfer checkpoint, report its contents, and return the model."""
    import hashlib
    from importlib.metadata import version

    from gsgen.contract.spec.manifest import Producer
    from gsgen.reference_plugins.diffusion.model_config import read_model_config
    from gsgen.reference_plugins.images.stylise import Stylise, StyliseOptions
    from gsgen.reference_plugins.loading.safetensors import read_safetensors
    from gsgen.reference_plugins.loading.states import require_tensors

    image_size = read_size(size)
    config = read_model_config(checkpoint)
    options = StyliseOptions(config.integer("channels", 16), config.integer("blocks", 3, least=0))
    network = Stylise(options, image_size, slider=slider)
    path = checkpoint / "stylise.safetensors"
    expected = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    network.load_state_dict(require_tensors(path, read_safetensors(path), expected), strict=True)
    count = sum(weight.numel() for weight in network.parameters())
    note(f"{path}: {count:,} weights, {options.blocks} residual blocks")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    network.producer = Producer(f"gsgen {version('gsgen')}", weights_sha256=digest)
    return network


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.images.synthetic_images import write_stylise

    write_stylise(folder, drawing=True)
    return ["--checkpoint", str(folder), "--size", "240x240"]


PLUGIN = Plugin(
    name="stylise",
    summary="A feed-forward network that redraws the rendered image in another style (post-process).",
    reads="Reads DIR/config.json (channels, blocks) and DIR/stylise.safetensors.",
    inputs=("image", "control"),
    publication=Publication(paper="Johnson et al. 2016", arxiv="1603.08155"),
    demo=Demo(write=_write_demo, caption="a rendered image, and its drawing"),
    build=build,
)

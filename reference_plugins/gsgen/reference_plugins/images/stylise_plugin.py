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
    from gsgen.reference_plugins.styles.style_checkpoint import StyleFiles
    from gsgen.reference_plugins.styles.style_transfer import StyleTransfer

_CONFIG_FILE, _WEIGHTS_FILE = "config.json", "stylise.safetensors"

Weights = Annotated[
    Path,
    typer.Option(
        "--checkpoint",
        help="File of weights; or a folder with config.json and stylise.safetensors, or with "
        "AdaIN's decoder.pth and vgg_normalised.pth.",
        show_default=False,
    ),
]
SizeOption = Annotated[
    str, typer.Option(help="Image size as WIDTHxHEIGHT; or any, which prevents graph capture.")
]
SliderOption = Annotated[
    bool,
    typer.Option("--slider/--no-slider", help="Declare the strength of the style as an input."),
]
PictureOption = Annotated[
    Path | None, typer.Option("--style", help="AdaIN: picture of the style.", show_default="none")
]
SideOption = Annotated[
    int,
    typer.Option(
        "--style-size", help="AdaIN: shorter side of the style's picture; 0 leaves it.", min=0
    ),
]
CornersOption = Annotated[
    bool,
    typer.Option(
        "--align-corners/--align-pixels",
        help="AnimeGANv2: what stays in place as features are enlarged.",
    ),
]


def build(
    checkpoint: Weights,
    size: SizeOption = "640x360",
    *,
    slider: SliderOption = True,
    style: PictureOption = None,
    style_size: SideOption = 512,
    align_corners: CornersOption = True,
) -> "StyleTransfer":
    """Read a style transfer checkpoint, report its contents, and return the model."""
    from gsgen.reference_plugins.loading.provenance import producer_of_weights
    from gsgen.reference_plugins.styles.style_checkpoint import StyleFiles, read_style

    files = StyleFiles(
        weights=checkpoint,
        style=style,
        style_side=style_size,
        align_corners=align_corners,
        size=read_size(size),
        slider=slider,
    )
    network: StyleTransfer
    if (checkpoint / _CONFIG_FILE).is_file() or (checkpoint / _WEIGHTS_FILE).is_file():
        network, paths = _read_own_layout(files), [checkpoint / _WEIGHTS_FILE]
    else:
        network, paths = read_style(files), files.paths
    count = sum(weight.numel() for weight in network.parameters())
    note(f"{paths[0]}: {network.describe()}, {count:,} weights")
    network.producer = producer_of_weights(network.source, paths)
    return network


def _read_own_layout(files: "StyleFiles") -> "Stylise":
    from gsgen.reference_plugins.diffusion.model_config import read_model_config
    from gsgen.reference_plugins.images.stylise import Stylise, StyliseOptions
    from gsgen.reference_plugins.loading.safetensors import read_safetensors
    from gsgen.reference_plugins.loading.states import require_tensors

    config, path = read_model_config(files.weights), files.weights / _WEIGHTS_FILE
    options = StyliseOptions(config.integer("channels", 16), config.integer("blocks", 3, least=0))
    network = Stylise(options, files.size, slider=files.slider)
    expected = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    network.load_state_dict(require_tensors(path, read_safetensors(path), expected), strict=True)
    return network


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.images.synthetic_images import write_stylise

    write_stylise(folder, drawing=True)
    return ["--checkpoint", str(folder), "--size", "240x240"]


PLUGIN = Plugin(
    name="stylise",
    words="stylize style style-transfer adain animegan",
    summary="A feed-forward network that redraws the rendered image in another style (post-process).",
    reads="Reads a file of weights of fast neural style or AnimeGANv2, DIR/decoder.pth and "
    "DIR/vgg_normalised.pth of AdaIN, or DIR/config.json (channels, blocks) and "
    "DIR/stylise.safetensors.",
    inputs=("image", "control"),
    publication=Publication(paper="Johnson et al. 2016", arxiv="1603.08155"),
    demo=Demo(write=_write_demo, caption="a rendered image, and its drawing"),
    build=build,
)

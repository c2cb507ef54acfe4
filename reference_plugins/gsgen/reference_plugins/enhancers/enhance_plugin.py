"""The command `gsgen export enhance`: exports a network that restores or enlarges images."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.reference_plugins.loading.image_sizes import read_size
from gsgen.reference_plugins.loading.options import note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.enhancers.enhancer import Enhancer

File = Annotated[
    Path, typer.Option("--checkpoint", help="File of the network's weights.", show_default=False)
]
SizeOption = Annotated[
    str,
    typer.Option(
        help="Size of the images that are enhanced as WIDTHxHEIGHT, larger ones in tiles; or any, "
        "which prevents graph capture."
    ),
]

_PAPER_REFERENCE = Publication(
    paper="Wang et al. 2021 (Real-ESRGAN), Liang et al. 2021 (SwinIR), Chen et al. 2022 (NAFNet)",
    arxiv="2107.10833",
    code="https://github.com/xinntao/Real-ESRGAN",
    licence="BSD-3-Clause; SwinIR Apache-2.0; NAFNet MIT",
)


def build(checkpoint: File, size: SizeOption = "256x256") -> "Enhancer":
    """Read a network of a known layout, report its contents, and return the model."""
    from gsgen.reference_plugins.enhancers.enhancer import Enhancer
    from gsgen.reference_plugins.enhancers.enhancer_checkpoint import read_network
    from gsgen.reference_plugins.loading.provenance import producer_of_weights

    image_size = read_size(size)
    network = read_network(checkpoint)
    count = sum(weight.numel() for weight in network.parameters())
    note(f"{checkpoint}: {network.describe()}, {count:,} weights")
    enhancer = Enhancer(network, image_size)
    enhancer.producer = producer_of_weights(network.source, [checkpoint])
    return enhancer


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.enhancers.synthetic_enhancers import write_enhancer

    file = write_enhancer(folder / "cubic.pth", "compact", layers=0, cubic=True)
    return ["--checkpoint", str(file), "--size", "60x60"]


PLUGIN = Plugin(
    name="enhance",
    words="upscale super-resolution esrgan real-esrgan swinir nafnet sr",
    summary="A network that restores or enlarges the rendered image: Real-ESRGAN, SwinIR or NAFNet (post-process).",
    reads="Reads a file of weights; its tensors tell which network it is, and how large.",
    inputs=("image",),
    publication=_PAPER_REFERENCE,
    demo=Demo(write=_write_demo, caption="a picture of few pixels, and enlarged four times"),
    build=build,
)

"""`gsgen export lgm`: exports a checkpoint of LGM to ONNX."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.reference_plugins.loading.errors import NotInCheckpoint
from gsgen.reference_plugins.loading.options import note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.feed_forward.lgm import Lgm

_Weights = Annotated[
    Path,
    typer.Option(
        "--checkpoint",
        help="The file of weights, or a folder with model.safetensors.",
        show_default=False,
    ),
]
_Side = Annotated[int, typer.Option(help="Pixels of a side of the pictures.", min=16)]
_PAPER_REFERENCE = Publication(
    paper="Tang et al. 2024",
    arxiv="2402.05054",
    code="https://github.com/3DTopia/LGM",
    licence="MIT",
)


def build(checkpoint: _Weights, side: _Side = 256) -> "Lgm":
    """Read a checkpoint of LGM, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.feed_forward.lgm import Lgm
    from gsgen.reference_plugins.feed_forward.lgm_checkpoint import read_lgm
    from gsgen.reference_plugins.loading.provenance import producer_of_weights

    read = read_lgm(checkpoint)
    stride = int(2 ** (len(read.unet.options.down) - 1))
    if side % stride:
        message = f"is {side}, expected a multiple of {stride}, as the network halves it so often"
        raise NotInCheckpoint(message, where="--side")
    count = 4 * (side // read.unet.options.shrink) ** 2
    note(f"{read.describe()}; {count:,} Gaussians of four pictures of {side}×{side}")
    generator = Lgm(read, side)
    generator.producer = producer_of_weights(_PAPER_REFERENCE.code, [read.weights])
    return generator


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.feed_forward.synthetic_feed_forward import write_lgm

    write_lgm(folder, relief=64)
    return ["--checkpoint", str(folder), "--side", "64"]


def _write_pictures(folder: Path) -> list[Path]:
    from PIL import Image

    from gsgen.reference_plugins.feed_forward.relief_weights import ball_picture

    Image.fromarray(ball_picture(64)).save(folder / "ball.png")
    return 4 * [folder / "ball.png"]


PLUGIN = Plugin(
    name="lgm",
    words="image-to-3d text-to-3d multi-view feed-forward",
    title="LGM",
    summary="An object from four pictures around it.",
    reads="Reads model.safetensors, or another file of weights.",
    inputs=("image",),
    publication=_PAPER_REFERENCE,
    demo=Demo(write=_write_demo, caption="around it", view="orbit", pictures=_write_pictures),
    build=build,
)

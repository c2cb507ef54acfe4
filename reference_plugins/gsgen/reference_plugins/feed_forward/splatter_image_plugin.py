"""`gsgen export splatter-image`: exports a checkpoint of Splatter Image to ONNX."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.loading.options import Checkpoint, note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.feed_forward.splatter_image import SplatterImage

_PAPER_REFERENCE = Publication(
    paper="Szymanowicz et al. 2024",
    arxiv="2312.13150",
    code="https://github.com/szymanowiczs/splatter-image",
    licence="no licence file; its U-Net is EDM's, CC BY-NC-SA 4.0",
)


def build(checkpoint: Checkpoint) -> "SplatterImage":
    """Read a checkpoint of Splatter Image, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.feed_forward.splatter_image import SplatterImage
    from gsgen.reference_plugins.feed_forward.splatter_image_checkpoint import read_splatter_image
    from gsgen.reference_plugins.loading.provenance import producer_of_weights

    read = read_splatter_image(checkpoint)
    note(read.describe())
    generator = SplatterImage(read)
    generator.producer = producer_of_weights(_PAPER_REFERENCE.code, [read.weights])
    return generator


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.feed_forward.synthetic_feed_forward import write_splatter_image

    write_splatter_image(folder, side=128, width=16, relief=True)
    return ["--checkpoint", str(folder)]


def _write_pictures(folder: Path) -> list[Path]:
    from PIL import Image

    from gsgen.reference_plugins.feed_forward.relief_weights import ball_picture

    Image.fromarray(ball_picture(128, stripes=6)).save(folder / "ball.png")
    return [folder / "ball.png"]


PLUGIN = Plugin(
    name="splatter-image",
    words="splatterimage image-to-3d single-image feed-forward",
    title="Splatter Image",
    summary="An object from one picture or a few, a Gaussian for each pixel.",
    reads="Reads DIR/.hydra/config.yaml and DIR/model_latest.pth.",
    inputs=("image", "image_view", "image_intrinsics"),
    publication=_PAPER_REFERENCE,
    demo=Demo(
        write=_write_demo,
        caption="a ball in relief, from left to right",
        view="swing",
        pictures=_write_pictures,
    ),
    build=build,
)

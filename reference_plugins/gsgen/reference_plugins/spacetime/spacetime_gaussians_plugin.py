"""The command `gsgen export spacetime-gaussians`: exports SpacetimeGaussians to ONNX."""

__all__ = ["PLUGIN"]

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.reference_plugins.loading.method_detection import point_columns
from gsgen.reference_plugins.loading.options import (
    CloudFile,
    IterationOption,
    note,
    report_checkpoint,
    with_time_options,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.contract.spec.manifest import Input
    from gsgen.reference_plugins.spacetime.spacetime_checkpoint import SpacetimeCheckpoint
    from gsgen.sdk import GaussianGenerator, PostProcess

_Decode = Annotated[
    Literal["per-splat", "features", "decoder"] | None,
    typer.Option(
        help="What to export of the full model, which decodes features in each pixel: features, a "
        "generator that emits them; decoder, the post-process model that decodes them; or "
        "per-splat, a generator that decodes them for each Gaussian, with approximate colours.",
        show_default="none, for the lite model",
    ),
]
_SizeOption = Annotated[
    str, typer.Option(help="Image size of --decode decoder, as WIDTHxHEIGHT: 640x360.")
]
_PAPER_REFERENCE = Publication(
    paper="Li et al. 2024",
    arxiv="2312.16812",
    code="https://github.com/oppo-us-research/SpacetimeGaussians",
    licence="MIT; its files name Inria's licence, for research only",
)


@with_time_options
def build(
    checkpoint: CloudFile,
    iteration: IterationOption = None,
    *,
    time: "Input",
    decode: _Decode = None,
    size: _SizeOption = "640x360",
) -> "GaussianGenerator | PostProcess":
    """Read a checkpoint of SpacetimeGaussians, report its contents, and return its model."""
    from gsgen.reference_plugins.loading.provenance import producer_of
    from gsgen.reference_plugins.spacetime.spacetime_checkpoint import read_spacetime

    read = read_spacetime(checkpoint, iteration)
    report_checkpoint(read.describe(), read.run.cfg)
    duration = read.run.cfg.integer("duration", 0)
    time = replace(time, frames=time.frames or duration or None)
    model = _exported_module(read, time, decode, size)
    model.producer = producer_of(_PAPER_REFERENCE.code, read.run, read.files)
    return model


def _exported_module(
    read: "SpacetimeCheckpoint", time: "Input", decode: str | None, size: str
) -> "GaussianGenerator | PostProcess":
    """Return the generator or, for --decode decoder, the post-process that decodes features."""
    from gsgen.reference_plugins.loading.errors import NotInCheckpoint
    from gsgen.reference_plugins.spacetime.feature_decoding import (
        FeaturePasses,
        FeatureScale,
        PixelDecoder,
    )
    from gsgen.reference_plugins.spacetime.spacetime_gaussians import SpacetimeGaussians

    if read.decoder is None:
        if decode is not None:
            message = "the checkpoint is a lite model, whose colours need no decoder"
            raise NotInCheckpoint(message, where=str(read.cloud), hint="Leave out --decode.")
        generator = SpacetimeGaussians(read.splats, None, time)
        if generator.color_range is not None:
            low, high = generator.color_range
            note(f"note: colours from {low:g} to {high:g} are blended as the method blends them")
        return generator
    match decode:
        case "per-splat":
            note(
                "warning: colours are approximate where Gaussians blend: the method decodes pixels"
            )
            return SpacetimeGaussians(read.splats, read.decoder, time)
        case "features":
            note("note: the colours are features, which the model of --decode decoder decodes")
            return FeaturePasses(read.splats, time)
        case "decoder":
            return PixelDecoder(read.decoder, FeatureScale.of(read.splats), _image_size(size))
    message = "the checkpoint is a full model, whose features are blended and decoded per pixel"
    hint = (
        "Give --decode features and --decode decoder, a model each, or --decode per-splat, which "
        "decodes each Gaussian by itself: an approximation."
    )
    raise NotInCheckpoint(message, where=str(read.cloud), hint=hint)


def _image_size(size: str) -> tuple[int, int]:
    from gsgen.contract.errors import ConfigInvalid
    from gsgen.reference_plugins.loading.image_sizes import read_size

    image_size = read_size(size)
    if image_size is None:
        hint = "The model has a ray for each pixel: give the size as 640x360."
        raise ConfigInvalid(
            "'any' is not an image size for --decode decoder", where="--size", hint=hint
        )
    return image_size


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.spacetime.synthetic_spacetime import write_spacetime

    write_spacetime(folder, count=12_000)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="spacetime-gaussians",
    words="stg spacetime spacetimegaussians",
    title="SpacetimeGaussians",
    summary="Gaussians that move along polynomials, each for a part of the time.",
    reads="Reads a PLY with motion, or DIR/cfg_args and DIR/point_cloud/iteration_N: "
    "point_cloud.ply, and point_cloud.pt of the full model.",
    inputs=("time", "view", "control"),
    publication=_PAPER_REFERENCE,
    recognises=lambda run, iteration: "trbf_center" in point_columns(iteration),
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)

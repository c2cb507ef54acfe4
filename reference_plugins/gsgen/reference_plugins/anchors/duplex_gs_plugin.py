"""The command `gsgen export duplex-gs`: exports a Duplex-GS checkpoint as an ONNX generator."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.reference_plugins.loading.method_detection import point_columns
from gsgen.reference_plugins.loading.options import (
    AppearanceId,
    Checkpoint,
    FrustumCull,
    IterationOption,
    MaxAnchors,
    note,
    report_checkpoint,
    warn_unsupported,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.anchors.duplex_gs import DuplexGS


OpacityOption = Annotated[
    Literal["decoded", "weighted"],
    typer.Option(
        help="decoded: that of the network. weighted: times the cell's visibility and its weight "
        "at that depth, as in the method's renderer."
    ),
]
BlendOption = Annotated[
    Literal["alpha", "wsr"],
    typer.Option(
        help="alpha: for renderers that sort Gaussians. wsr: the method's own weighted sum, cell "
        "by cell; the model also emits the cells."
    ),
]
_PAPER_REFERENCE = Publication(
    paper="Liu et al. 2025",
    arxiv="2508.03180",
    code="https://github.com/LiYukeee/Duplex-GS",
    licence="Inria and MPII, for research only",
)


def build(
    checkpoint: Checkpoint,
    iteration: IterationOption = None,
    opacity: OpacityOption = "decoded",
    blend: BlendOption = "alpha",
    appearance_id: AppearanceId = None,
    cull: FrustumCull = "none",
    max_anchors: MaxAnchors = None,
) -> "DuplexGS":
    """Read a checkpoint of Duplex-GS, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.anchors.anchor_checkpoint import require_appearance
    from gsgen.reference_plugins.anchors.cell_checkpoint import describe_cells, read_cells
    from gsgen.reference_plugins.anchors.duplex_gs import DuplexGS
    from gsgen.reference_plugins.anchors.octree_gs import SUPPORTED_OPTIONS, Levels
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_cells(checkpoint, iteration)
    levels = Levels.of(read.anchors)
    report_checkpoint(
        f"{describe_cells(read)}; {levels.mode} to whole levels, fork {levels.fork:g}",
        read.anchors.run.cfg,
    )
    if blend == "alpha":
        note(
            "note: the method blends by a weighted sum of cells; this model needs sorted "
            "Gaussians. --blend wsr keeps the cells"
        )
    warn_unsupported(read.anchors.run.cfg, SUPPORTED_OPTIONS)
    appearance = require_appearance(read.anchors, appearance_id, "--appearance-id")
    generator = DuplexGS(
        read,
        levels,
        opacity=opacity,
        blend=blend,
        appearance=appearance,
        selection=Selection(cull, max_anchors),
    )
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.anchors.run)
    return generator


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.anchors.synthetic_anchors import AnchorOptions, write_duplex

    write_duplex(folder, AnchorOptions(anchors=3000, iteration=40_000))
    return ["--checkpoint", str(folder), "--blend", "wsr"]


PLUGIN = Plugin(
    name="duplex-gs",
    words="duplex duplexgs",
    title="Duplex-GS",
    summary="Ellipsoidal cells whose networks make Gaussians within them.",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply with cells and "
    "the networks, opacity_mlp.pt, cov_mlp.pt, color_mlp.pt (feature_bank_mlp.pt, "
    "embedding_appearance.pt), or all of them in checkpoints.pth.",
    inputs=("view", "projection", "appearance_id"),
    publication=_PAPER_REFERENCE,
    recognises=lambda run, iteration: "anchor_size_0" in point_columns(iteration),
    demo=Demo(write=_write_demo, caption="around it"),
    build=build,
)

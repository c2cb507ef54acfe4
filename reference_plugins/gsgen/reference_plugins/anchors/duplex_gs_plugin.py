"""`gsgen export duplex-gs`: a Duplex-GS checkpoint as a generator."""

__all__ = ["PLUGIN"]

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.reference_plugins.loading.options import (
    AppearanceId,
    Checkpoint,
    Iteration,
    MaxAnchors,
    note,
    tell,
    warn_of,
)
from gsgen.sdk.plugins.plugin import Plugin

if TYPE_CHECKING:
    from gsgen.reference_plugins.anchors.duplex_gs import DuplexGS

_HONOURED = {
    "resolution_scales": ([1.0], "levels are those of images at full resolution"),
}
_SOURCE = "https://github.com/LiYukeee/Duplex-GS"

OpacityOption = Annotated[
    Literal["decoded", "weighted"],
    typer.Option(
        help="decoded: as the network says. weighted: times the cell's visibility and its weight "
        "at that depth, from which the method's renderer starts.",
    ),
]
BlendOption = Annotated[
    Literal["alpha", "wsr"],
    typer.Option(
        help="alpha: for renderers that sort Gaussians. wsr: as the method itself does, a "
        "weighted sum cell by cell; the model gives the cells, too.",
    ),
]
CullOption = Annotated[
    Literal["none", "frustum"],
    typer.Option(
        "--cull", help="Hide cells that are surely out of view (adds projection)."
    ),
]


def build(
    checkpoint: Checkpoint,
    iteration: Iteration = None,
    opacity: OpacityOption = "decoded",
    blend: BlendOption = "alpha",
    appearance_id: AppearanceId = None,
    cull: CullOption = "none",
    max_anchors: MaxAnchors = None,
) -> "DuplexGS":
    """Read a checkpoint, say what is in it, and return its generator."""
    from gsgen.reference_plugins.anchors.anchor_checkpoint import require_appearance
    from gsgen.reference_plugins.anchors.cell_checkpoint import describe_cells, read_cells
    from gsgen.reference_plugins.anchors.duplex_gs import DuplexGS
    from gsgen.reference_plugins.anchors.octree_gs import Levels
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_cells(checkpoint, iteration)
    levels = Levels.of(read.anchors)
    tell(
        f"{describe_cells(read)}; {levels.mode} to whole levels, fork {levels.fork:g}",
        read.anchors.cfg,
    )
    if blend == "alpha":
        note(
            "note: the method blends by a weighted sum of cells; this model is blended by "
            "sorting. --blend wsr keeps the cells"
        )
    warn_of(read.anchors.cfg, _HONOURED)
    appearance = require_appearance(read.anchors, appearance_id, "--appearance-id")
    made = DuplexGS(
        read,
        levels,
        opacity=opacity,
        blend=blend,
        appearance=appearance,
        selection=Selection(cull, max_anchors),
    )
    made.producer = producer_of(_SOURCE, read.anchors.folder, read.anchors.iteration)
    return made


PLUGIN = Plugin(
    name="duplex-gs",
    summary="Ellipsoidal cells whose networks make Gaussians within them (Duplex-GS).",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply with cells and "
    "the networks, opacity_mlp.pt, cov_mlp.pt, color_mlp.pt (feature_bank_mlp.pt, "
    "embedding_appearance.pt), or all of them in checkpoints.pth.",
    inputs=("view", "projection", "appearance_id"),
    build=build,
)

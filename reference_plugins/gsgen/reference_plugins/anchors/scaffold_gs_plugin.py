"""`gsgen export scaffold-gs`: a Scaffold-GS checkpoint as a generator."""

__all__ = ["PLUGIN"]

from typing import TYPE_CHECKING

from gsgen.reference_plugins.loading.options import (
    AppearanceId,
    Checkpoint,
    CullOption,
    Iteration,
    MaxAnchors,
    note,
    tell,
)
from gsgen.sdk.plugins.plugin import Plugin

if TYPE_CHECKING:
    from gsgen.reference_plugins.anchors.scaffold_gs import ScaffoldGS

_SOURCE = "https://github.com/city-super/Scaffold-GS"


def build(
    checkpoint: Checkpoint,
    iteration: Iteration = None,
    appearance_id: AppearanceId = None,
    cull: CullOption = "none",
    max_anchors: MaxAnchors = None,
) -> "ScaffoldGS":
    """Read a checkpoint, say what is in it, and return its generator."""
    from gsgen.reference_plugins.anchors.anchor_checkpoint import (
        describe_anchors,
        read_anchors,
        require_appearance,
    )
    from gsgen.reference_plugins.anchors.scaffold_gs import ScaffoldGS
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_anchors(checkpoint, iteration)
    tell(describe_anchors(read), read.cfg)
    if not read.cfg.present:
        note(
            f"note: there is no {read.cfg.path}; flags are taken from the networks' shapes"
        )
    selection = Selection(cull, max_anchors)
    appearance = require_appearance(read, appearance_id, "--appearance-id")
    made = ScaffoldGS(read.cloud, read.nets, appearance=appearance, selection=selection)
    made.producer = producer_of(_SOURCE, read.folder, read.iteration)
    return made


PLUGIN = Plugin(
    name="scaffold-gs",
    summary="Anchors whose networks make view-dependent Gaussians (Scaffold-GS).",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply and the networks, "
    "opacity_mlp.pt, cov_mlp.pt, color_mlp.pt (feature_bank_mlp.pt, embedding_appearance.pt), "
    "or all of them in checkpoints.pth.",
    inputs=("view", "projection", "viewport", "appearance_id"),
    build=build,
)

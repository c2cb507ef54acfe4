"""`gsgen export octree-gs`: an Octree-GS checkpoint as a generator."""

__all__ = ["PLUGIN"]

from typing import TYPE_CHECKING

from gsgen.reference_plugins.loading.options import (
    AppearanceId,
    Checkpoint,
    CullOption,
    Iteration,
    MaxAnchors,
    tell,
    warn_of,
)
from gsgen.sdk.plugins.plugin import Plugin

if TYPE_CHECKING:
    from gsgen.reference_plugins.anchors.octree_gs import OctreeGS

_HONOURED = {
    "resolution_scales": ([1.0], "levels are those of images at full resolution"),
}
_SOURCE = "https://github.com/city-super/Octree-GS"


def build(
    checkpoint: Checkpoint,
    iteration: Iteration = None,
    appearance_id: AppearanceId = None,
    cull: CullOption = "none",
    max_anchors: MaxAnchors = None,
) -> "OctreeGS":
    """Read a checkpoint, say what is in it, and return its generator."""
    from gsgen.reference_plugins.anchors.anchor_checkpoint import (
        describe_anchors,
        read_anchors,
        require_appearance,
    )
    from gsgen.reference_plugins.anchors.octree_gs import Levels, OctreeGS
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_anchors(checkpoint, iteration, octree=True)
    levels = Levels.of(read)
    tell(
        f"{describe_anchors(read)}; {levels.mode} to whole levels, fork {levels.fork:g}",
        read.cfg,
    )
    warn_of(read.cfg, _HONOURED)
    selection = Selection(cull, max_anchors)
    appearance = require_appearance(read, appearance_id, "--appearance-id")
    made = OctreeGS(
        read.cloud, read.nets, levels, appearance=appearance, selection=selection
    )
    made.producer = producer_of(_SOURCE, read.folder, read.iteration)
    return made


PLUGIN = Plugin(
    name="octree-gs",
    summary="Anchors in levels of detail, chosen by distance (Octree-GS).",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply with levels and "
    "the networks, opacity_mlp.pt, cov_mlp.pt, color_mlp.pt (feature_bank_mlp.pt, "
    "embedding_appearance.pt), or all of them in checkpoints.pth.",
    inputs=("view", "projection", "viewport", "appearance_id"),
    build=build,
)

"""The command `gsgen export octree-gs`: exports an Octree-GS checkpoint as an ONNX generator."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.loading.method_detection import is_octree_anygs, point_columns
from gsgen.reference_plugins.loading.options import (
    AppearanceId,
    Checkpoint,
    CullOption,
    IterationOption,
    MaxAnchors,
    report_checkpoint,
    warn_unsupported,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.anchors.octree_gs import OctreeGS

_PAPER_REFERENCE = Publication(
    paper="Ren et al. 2024",
    arxiv="2403.17898",
    code="https://github.com/city-super/Octree-GS",
    licence="Inria and MPII, for research only",
)


def build(
    checkpoint: Checkpoint,
    iteration: IterationOption = None,
    appearance_id: AppearanceId = None,
    cull: CullOption = "none",
    max_anchors: MaxAnchors = None,
) -> "OctreeGS":
    """Read a checkpoint of Octree-GS, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.anchors.anchor_checkpoint import (
        describe_anchors,
        read_anchors,
        require_appearance,
    )
    from gsgen.reference_plugins.anchors.octree_gs import SUPPORTED_OPTIONS, Levels, OctreeGS
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_anchors(checkpoint, iteration, octree=True)
    levels = Levels.of(read)
    report_checkpoint(
        f"{describe_anchors(read)}; {levels.mode} to whole levels, fork {levels.fork:g}",
        read.run.cfg,
    )
    warn_unsupported(read.run.cfg, SUPPORTED_OPTIONS)
    selection = Selection(cull, max_anchors)
    appearance = require_appearance(read, appearance_id, "--appearance-id")
    generator = OctreeGS(read.cloud, read.nets, levels, appearance=appearance, selection=selection)
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run)
    return generator


def _recognises(run: Path, iteration: Path) -> bool:
    columns = set(point_columns(iteration))
    is_other_method = "anchor_size_0" in columns or is_octree_anygs(iteration)
    return {"f_offset_0", "level"} <= columns and not is_other_method


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.anchors.synthetic_anchors import AnchorOptions, write_octree

    options = AnchorOptions(anchors=3000, iteration=40_000)
    write_octree(folder, options, levels=5, distance=48)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="octree-gs",
    words="octree octreegs",
    title="Octree-GS",
    summary="Anchors in levels of detail, chosen by distance.",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply with levels and "
    "the networks, opacity_mlp.pt, cov_mlp.pt, color_mlp.pt (feature_bank_mlp.pt, "
    "embedding_appearance.pt), or all of them in checkpoints.pth.",
    inputs=("view", "projection", "viewport", "appearance_id"),
    publication=_PAPER_REFERENCE,
    recognises=_recognises,
    demo=Demo(write=_write_demo, caption="from ever farther, zoomed in: levels go", view="recede"),
    build=build,
)

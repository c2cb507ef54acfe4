"""The command `gsgen export scaffold-gs`: exports a Scaffold-GS checkpoint as an ONNX generator."""

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
    note,
    report_checkpoint,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.anchors.scaffold_gs import ScaffoldGS
_PAPER_REFERENCE = Publication(
    paper="Lu et al. 2024",
    arxiv="2312.00109",
    code="https://github.com/city-super/Scaffold-GS",
    licence="Inria and MPII, for research only",
)


def build(
    checkpoint: Checkpoint,
    iteration: IterationOption = None,
    appearance_id: AppearanceId = None,
    cull: CullOption = "none",
    max_anchors: MaxAnchors = None,
) -> "ScaffoldGS":
    """Read a checkpoint of Scaffold-GS, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.anchors.anchor_checkpoint import (
        describe_anchors,
        read_anchors,
        require_appearance,
    )
    from gsgen.reference_plugins.anchors.scaffold_gs import ScaffoldGS
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.loading.provenance import producer_of

    saved_anchors = read_anchors(checkpoint, iteration)
    report_checkpoint(describe_anchors(saved_anchors), saved_anchors.run.cfg)
    if not saved_anchors.run.cfg.file_exists:
        note(
            f"note: {saved_anchors.run.cfg.path} is missing; its flags follow from the networks' shapes"
        )
    selection = Selection(cull, max_anchors)
    appearance = require_appearance(saved_anchors, appearance_id, "--appearance-id")
    generator = ScaffoldGS(
        saved_anchors.cloud, saved_anchors.nets, appearance=appearance, selection=selection
    )
    generator.producer = producer_of(_PAPER_REFERENCE.code, saved_anchors.run)
    return generator


def _recognises(run: Path, iteration: Path) -> bool:
    columns = set(point_columns(iteration))
    is_other_method = bool({"level", "anchor_size_0"} & columns) or is_octree_anygs(iteration)
    return "f_offset_0" in columns and not is_other_method


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.anchors.synthetic_anchors import AnchorOptions, write_scaffold

    write_scaffold(folder, AnchorOptions(anchors=3000))
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="scaffold-gs",
    words="scaffold scaffoldgs anchors",
    title="Scaffold-GS",
    summary="Anchors whose networks make view-dependent Gaussians.",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply and the networks, "
    "opacity_mlp.pt, cov_mlp.pt, color_mlp.pt (feature_bank_mlp.pt, embedding_appearance.pt), "
    "or all of them in checkpoints.pth.",
    inputs=("view", "projection", "viewport", "appearance_id"),
    publication=_PAPER_REFERENCE,
    recognises=_recognises,
    demo=Demo(write=_write_demo, caption="around it: colours follow the camera"),
    build=build,
)

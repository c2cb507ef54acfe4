"""The command `gsgen export octree-anygs`: exports an Octree-AnyGS checkpoint to ONNX."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.loading.method_detection import is_octree_anygs
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
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.octree_anygs.anygs_checkpoint import AnyGSCheckpoint
    from gsgen.sdk import GaussianGenerator
    from gsgen.sdk.exporting.constant_generator import ConstantSource

_PAPER_REFERENCE = Publication(
    paper="Ren et al. 2024",
    arxiv="2403.17898",
    code="https://github.com/city-super/Octree-AnyGS",
    licence="Inria and MPII, for research only",
)


def build(
    checkpoint: Checkpoint,
    iteration: IterationOption = None,
    appearance_id: AppearanceId = None,
    cull: FrustumCull = "none",
    max_anchors: MaxAnchors = None,
) -> "GaussianGenerator | ConstantSource":
    """Read a checkpoint of Octree-AnyGS, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.anchors.octree_gs import SUPPORTED_OPTIONS
    from gsgen.reference_plugins.anchors.selection import Selection
    from gsgen.reference_plugins.loading.provenance import producer_of
    from gsgen.reference_plugins.octree_anygs.anygs_checkpoint import describe_anygs, read_anygs
    from gsgen.reference_plugins.octree_anygs.explicit_gaussians import (
        LeveledGaussians,
        explicit_splats,
    )
    from gsgen.reference_plugins.static.static import StaticScene

    read = read_anygs(checkpoint, iteration)
    report_checkpoint(describe_anygs(read), read.run.cfg)
    warn_unsupported(read.run.cfg, SUPPORTED_OPTIONS)
    if read.base == "2dgs":
        note("note: renderers of 3D Gaussians draw the discs with an affine projection")
    generator: GaussianGenerator
    if read.colors is None:
        generator = _neural_generator(read, appearance_id, Selection(cull, max_anchors))
    else:
        _refuse_neural_options(
            {"appearance_id": appearance_id, "max_anchors": max_anchors, "cull": cull}
        )
        if read.levels is None:
            splats = explicit_splats(read.cloud, read.colors, flat=read.base == "2dgs")
            return StaticScene(content=splats)
        generator = LeveledGaussians(read.cloud, read.colors, read.levels, flat=read.base == "2dgs")
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run)
    return generator


def _neural_generator(
    read: "AnyGSCheckpoint", appearance_id: int | None, selection: "Selection"
) -> "GaussianGenerator":
    from gsgen.reference_plugins.anchors.anchor_checkpoint import require_appearance
    from gsgen.reference_plugins.anchors.octree_gs import OctreeGS
    from gsgen.reference_plugins.anchors.scaffold_gs import ScaffoldGS

    assert read.anchors is not None
    cloud, nets = read.cloud, read.anchors.nets
    appearance = require_appearance(read.anchors, appearance_id, "--appearance-id")
    if read.levels is None:
        return ScaffoldGS(cloud, nets, appearance=appearance, selection=selection)
    return OctreeGS(
        cloud, nets, read.levels, appearance=appearance, selection=selection, half_cell=False
    )


def _refuse_neural_options(options: dict[str, object]) -> None:
    """Raise if an option for neural Gaussians is given for a checkpoint of explicit Gaussians."""
    for name, value in options.items():
        if value not in (None, "none"):
            raise ConfigInvalid(
                f"is {value}, but explicit Gaussians are not decoded by networks",
                where=f"--{name.replace('_', '-')}",
                hint="Leave out the option.",
            )


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.octree_anygs.synthetic_anygs import write_anygs

    write_anygs(folder, base="3dgs", count=15_000, levels=5, distance=48)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="octree-anygs",
    words="anygs octree-any",
    title="Octree-AnyGS",
    summary="Neural, explicit or flat Gaussians in levels of detail, chosen by distance.",
    reads="Reads DIR/cfg_args and DIR/point_cloud/iteration_N: point_cloud.ply and, of the base "
    "model scaffoldgs, the networks opacity_mlp.pt, cov_mlp.pt, color_mlp.pt "
    "(feature_bank_mlp.pt, embedding_appearance.pt).",
    inputs=("view", "projection", "appearance_id"),
    publication=_PAPER_REFERENCE,
    recognises=lambda run, iteration: is_octree_anygs(iteration),
    demo=Demo(write=_write_demo, caption="from ever farther, zoomed in: levels go", view="recede"),
    build=build,
)

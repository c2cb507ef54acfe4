"""`gsgen export gaussian-avatars`: exports a checkpoint of GaussianAvatars to ONNX."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.reference_plugins.loading.method_detection import point_columns
from gsgen.reference_plugins.loading.options import (
    Checkpoint,
    IterationOption,
    note,
    report_checkpoint,
)
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.reference_plugins.heads.gaussian_avatars import GaussianAvatars

_Body = Annotated[
    Path | None,
    typer.Option(
        help="The face model FLAME 2023, which requires registration.",
        show_default="flame2023.pkl in assets of the run",
    ),
]
_PAPER_REFERENCE = Publication(
    paper="Qian et al. 2024",
    arxiv="2312.02069",
    code="https://github.com/ShenhanQian/GaussianAvatars",
    licence="CC BY-NC-SA 4.0, with further conditions",
)


def build(
    checkpoint: Checkpoint, body: _Body = None, iteration: IterationOption = None
) -> "GaussianAvatars":
    """Read a checkpoint of GaussianAvatars, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.heads.gaussian_avatars import GaussianAvatars
    from gsgen.reference_plugins.heads.gaussian_avatars_checkpoint import read_gaussian_avatars
    from gsgen.reference_plugins.loading.provenance import producer_of

    read = read_gaussian_avatars(checkpoint, iteration, body)
    report_checkpoint(read.describe(), read.run.cfg)
    note("warning: the model contains parts of FLAME, whose licence forbids redistribution")
    generator = GaussianAvatars(read)
    generator.producer = producer_of(_PAPER_REFERENCE.code, read.run)
    return generator


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.heads.synthetic_head import write_gaussian_avatar

    write_gaussian_avatar(folder, count=9000, rings=40)
    return ["--checkpoint", str(folder)]


PLUGIN = Plugin(
    name="gaussian-avatars",
    words="flame head face gaussianavatars head-avatar avatar",
    title="GaussianAvatars",
    summary="A head that expressions and poses of FLAME move.",
    reads="Reads DIR/cfg_args, DIR/point_cloud/iteration_N: point_cloud.ply and flame_param.npz, "
    "and the face model that --body names or DIR/assets holds.",
    inputs=("pose", "expression", "root_translation"),
    publication=_PAPER_REFERENCE,
    recognises=lambda run, iteration: "binding_0" in point_columns(iteration),
    demo=Demo(write=_write_demo, caption="around it", view="head"),
    build=build,
)

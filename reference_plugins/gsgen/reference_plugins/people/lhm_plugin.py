"""The command `gsgen export lhm`: exports an LHM avatar as an ONNX generator."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.bodies.options import (
    BodyFile,
    Instances,
    MotionFile,
    Spacing,
    with_motion,
)
from gsgen.reference_plugins.loading.options import Checkpoint, Fps, Loop, note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.sdk import GaussianGenerator

FlameOption = Annotated[
    Path | None,
    typer.Option(
        "--flame", help="FLAME_NEUTRAL.pkl, whose expressions LHM uses.", show_default="none"
    ),
]
FlameIds = Annotated[
    Path | None,
    typer.Option(
        "--flame-ids", help="SMPL-X__FLAME_vertex_ids.npy, with --flame.", show_default="none"
    ),
]
NoExpression = Annotated[
    bool, typer.Option("--no-expression", help="Keep the neutral expression: no expression input.")
]


def build(
    checkpoint: Checkpoint,
    body: BodyFile = None,
    flame: FlameOption = None,
    flame_ids: FlameIds = None,
    instances: Instances = 1,
    motion: MotionFile = None,
    fps: Fps = None,
    spacing: Spacing = 1.0,
    *,
    no_expression: NoExpression = False,
    loop: Loop = False,
) -> "GaussianGenerator":
    """Read an avatar of LHM, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.bodies.motions import read_motion
    from gsgen.reference_plugins.people.lhm import LHM
    from gsgen.reference_plugins.people.lhm_checkpoint import read_face, read_lhm

    if (flame is None) != (flame_ids is None):
        message = "--flame and --flame-ids must be given together"
        raise ConfigInvalid(message, where="--flame", hint="Give both, or neither.")
    read = read_lhm(checkpoint, body)
    note(read.describe())
    face = read_face(flame, flame_ids, read.body) if flame and flame_ids else None
    if face is None and not no_expression:
        note(
            "warning: expressions are those of SMPL-X, but LHM uses those of FLAME: "
            "give --flame and --flame-ids, or --no-expression"
        )
    motion_recording = read_motion(motion, read.body.joints) if motion else None
    avatar = LHM(read, face, expression=not no_expression, bodies=instances)
    return with_motion(
        avatar, avatar.actors, motion_recording, read.body.kind, fps=fps, loop=loop, spacing=spacing
    )


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.bodies.synthetic_body import PersonOptions
    from gsgen.reference_plugins.bodies.synthetic_motion import write_demo_motion
    from gsgen.reference_plugins.people.synthetic_people import write_lhm

    write_lhm(folder, PersonOptions(count=6000, vertices=3000))
    return write_demo_motion(folder)


PLUGIN = Plugin(
    name="lhm",
    words="smpl smpl-x smplx human person avatar",
    title="LHM",
    summary="A person from one image, animated by SMPL-X poses.",
    reads="Reads the avatar's .pth in DIR, DIR/pretrained_models/dense_sample_points/*.ply and "
    "voxel_grid/human_prior_constrain.npz, and the SMPL-X model that --body names or DIR holds.",
    inputs=("pose", "root_translation", "expression", "time"),
    publication=Publication(
        paper="Qiu et al. 2025",
        arxiv="2503.10625",
        code="https://github.com/aigc3d/LHM",
        licence="Apache-2.0",
    ),
    demo=Demo(write=_write_demo, caption="a motion", view="person"),
    build=build,
)

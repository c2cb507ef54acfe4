"""`gsgen export lhm`: an avatar of LHM as a generator."""

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
    played,
)
from gsgen.reference_plugins.loading.options import Checkpoint, Fps, Loop, note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.sdk import GaussianGenerator

Flame = Annotated[
    Path | None,
    typer.Option(
        "--flame",
        help="FLAME_NEUTRAL.pkl, whose expressions LHM uses.",
        show_default="none",
    ),
]
FlameIds = Annotated[
    Path | None,
    typer.Option(
        "--flame-ids",
        help="SMPL-X__FLAME_vertex_ids.npy, with --flame.",
        show_default="none",
    ),
]
NoExpression = Annotated[
    bool, typer.Option("--no-expression", help="Leave the face as it is: no such input.")
]


def build(
    checkpoint: Checkpoint,
    body: BodyFile = None,
    flame: Flame = None,
    flame_ids: FlameIds = None,
    no_expression: NoExpression = False,
    instances: Instances = 1,
    motion: MotionFile = None,
    fps: Fps = None,
    loop: Loop = False,
    spacing: Spacing = 1.0,
) -> "GaussianGenerator":
    """Read an avatar, say what is in it, and return its generator."""
    from gsgen.reference_plugins.bodies.motions import read_motion
    from gsgen.reference_plugins.people.lhm import LHM
    from gsgen.reference_plugins.people.lhm_checkpoint import read_face, read_lhm

    if (flame is None) != (flame_ids is None):
        what = "--flame and --flame-ids go together"
        raise ConfigInvalid(what, where="--flame", hint="Give both, or neither.")
    read = read_lhm(checkpoint, body)
    note(read.describe())
    face = read_face(flame, flame_ids, read.body) if flame and flame_ids else None
    if face is None and not no_expression:
        note(
            "warning: expressions are those of SMPL-X; LHM has FLAME's in the face: "
            "give --flame and --flame-ids, or --no-expression"
        )
    told = read_motion(motion, read.body.joints) if motion else None
    avatar = LHM(read, face, expression=not no_expression, bodies=instances)
    return played(
        avatar, avatar.actors, told, read.body, fps=fps, loop=loop, spacing=spacing
    )


def _write_demo(folder: Path) -> list[str]:
    """Write a checkpoint of a person, and a motion to play."""
    from gsgen.reference_plugins.bodies.synthetic_body import PersonOptions
    from gsgen.reference_plugins.bodies.synthetic_motion import write_motion
    from gsgen.reference_plugins.people.synthetic_people import write_lhm

    write_lhm(folder, PersonOptions(count=6000, vertices=3000))
    motion = write_motion(folder / "walk.npz", frames=24)
    return ["--checkpoint", str(folder), "--motion", str(motion)]


PLUGIN = Plugin(
    name="lhm",
    title="LHM",
    summary="A person from one picture, whom SMPL-X moves.",
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

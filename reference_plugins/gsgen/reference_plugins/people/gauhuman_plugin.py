"""`gsgen export gauhuman`: a checkpoint of GauHuman as a generator."""

__all__ = ["PLUGIN"]

from typing import TYPE_CHECKING

from gsgen.reference_plugins.bodies.options import (
    BodyFile,
    Hands,
    Instances,
    MotionFile,
    RootRotation,
    Shape,
    Spacing,
    played,
    read_shape,
    warn_of_body,
)
from gsgen.reference_plugins.loading.options import Checkpoint, Fps, Iteration, Loop, tell
from gsgen.sdk.plugins.plugin import Plugin

if TYPE_CHECKING:
    from gsgen.sdk import GaussianGenerator


def build(
    checkpoint: Checkpoint,
    body: BodyFile = None,
    iteration: Iteration = None,
    shape: Shape = None,
    root_rotation: RootRotation = "matrix",
    hands: Hands = "full",
    instances: Instances = 1,
    motion: MotionFile = None,
    fps: Fps = None,
    loop: Loop = False,
    spacing: Spacing = 1.0,
) -> "GaussianGenerator":
    """Read a checkpoint, say what is in it, and return its generator."""
    from gsgen.reference_plugins.bodies.motions import read_motion
    from gsgen.reference_plugins.people.gauhuman import GauHuman
    from gsgen.reference_plugins.people.gauhuman_checkpoint import read_gauhuman

    read = read_gauhuman(checkpoint, iteration, body)
    tell(read.describe(), read.cfg)
    warn_of_body(read.cfg, read.body)
    told = read_motion(motion, read.body.joints) if motion else None
    avatar = GauHuman(
        read.canonical,
        read.body,
        read.nets,
        shape=read_shape(shape, told, read.body.shape_dirs.shape[2]),
        rotation="matrix" if told else root_rotation,
        bodies=instances,
        add_hands=hands == "raw",
    )
    return played(
        avatar, avatar.actors, told, read.body, fps=fps, loop=loop, spacing=spacing
    )


PLUGIN = Plugin(
    name="gauhuman",
    summary="A person whom SMPL or SMPL-X moves (GauHuman).",
    reads="Reads DIR/cfg_args, DIR/point_cloud/iteration_N/point_cloud.ply, the networks in "
    "DIR/mlp_ckpt/iteration_N/ckpt.pth where they were trained, and the body model that --body "
    "names or DIR/assets holds.",
    inputs=("pose", "root_rotation", "root_translation", "shape", "time"),
    build=build,
)

"""`gsgen export gauhuman`: a checkpoint of GauHuman as a generator."""

__all__ = ["PLUGIN"]

from typing import TYPE_CHECKING

from gsgen.reference_plugins.commands.avatar_options import (
    BodyFile,
    Instances,
    RootRotation,
    Shape,
    numbers_of,
)
from gsgen.reference_plugins.commands.options import Checkpoint, Iteration, note
from gsgen.sdk.plugin import Plugin

if TYPE_CHECKING:
    from gsgen.reference_plugins.gauhuman import GauHuman


def build(
    checkpoint: Checkpoint,
    body: BodyFile = None,
    iteration: Iteration = None,
    shape: Shape = None,
    root_rotation: RootRotation = "matrix",
    instances: Instances = 1,
) -> "GauHuman":
    """Read a checkpoint, say what is in it, and return its generator."""
    from gsgen.reference_plugins.checkpoints.gauhuman import read_gauhuman
    from gsgen.reference_plugins.gauhuman import GauHuman

    read = read_gauhuman(checkpoint, iteration, body)
    note(read.describe())
    baked = numbers_of(shape, read.body.shape_dirs.shape[2], "--shape")
    return GauHuman(
        read.canonical,
        read.body,
        read.nets,
        shape=baked,
        rotation=root_rotation,
        bodies=instances,
    )


PLUGIN = Plugin(
    name="gauhuman",
    summary="A person whom SMPL or SMPL-X moves (GauHuman).",
    reads="Reads DIR/cfg_args, DIR/point_cloud/iteration_N/point_cloud.ply, the networks in "
    "DIR/mlp_ckpt/iteration_N/ckpt.pth where they were trained, and the body model that --body "
    "names or DIR/assets holds.",
    inputs=("pose", "root_rotation", "root_translation", "shape"),
    build=build,
)

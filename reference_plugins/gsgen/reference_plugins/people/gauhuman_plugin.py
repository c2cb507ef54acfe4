"""The command `gsgen export gauhuman`: exports a GauHuman checkpoint as an ONNX generator."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.bodies.options import (
    BodyFile,
    HandsOption,
    Instances,
    MotionFile,
    RootRotation,
    Shape,
    Spacing,
    read_shape,
    warn_about_body,
    with_motion,
)
from gsgen.reference_plugins.loading.cfg_args import read_cfg_args
from gsgen.reference_plugins.loading.options import (
    Checkpoint,
    Fps,
    IterationOption,
    Loop,
    report_checkpoint,
)
from gsgen.reference_plugins.people.r3_detection import is_r3_run
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.sdk import GaussianGenerator


def build(
    checkpoint: Checkpoint,
    body: BodyFile = None,
    iteration: IterationOption = None,
    shape: Shape = None,
    root_rotation: RootRotation = "matrix",
    hands: HandsOption = "full",
    instances: Instances = 1,
    motion: MotionFile = None,
    fps: Fps = None,
    spacing: Spacing = 1.0,
    *,
    loop: Loop = False,
) -> "GaussianGenerator":
    """Read a checkpoint of GauHuman, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.bodies.motions import read_motion
    from gsgen.reference_plugins.people.gauhuman import GauHuman
    from gsgen.reference_plugins.people.gauhuman_checkpoint import read_gauhuman

    read = read_gauhuman(checkpoint, iteration, body)
    report_checkpoint(read.describe(), read.run.cfg)
    warn_about_body(read.run.cfg, read.body)
    motion_recording = read_motion(motion, read.body.joints) if motion else None
    avatar = GauHuman(
        read.canonical,
        read.body,
        read.nets,
        shape=read_shape(shape, motion_recording, read.body.shape_dirs.shape[2]),
        rotation="matrix" if motion_recording else root_rotation,
        bodies=instances,
        add_hands=hands == "raw",
    )
    return with_motion(
        avatar, avatar.actors, motion_recording, read.body.kind, fps=fps, loop=loop, spacing=spacing
    )


def _recognises(run: Path, iteration: Path) -> bool:
    """Return whether the training options name a body model and the run is not of R3-Avatar."""
    return "smpl_type" in read_cfg_args(run).values and not is_r3_run(run)


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.bodies.synthetic_body import PersonOptions
    from gsgen.reference_plugins.bodies.synthetic_motion import write_demo_motion
    from gsgen.reference_plugins.people.synthetic_people import write_gauhuman

    write_gauhuman(folder, PersonOptions(count=6000, vertices=3000))
    return write_demo_motion(folder)


PLUGIN = Plugin(
    name="gauhuman",
    words="smpl human body person avatar",
    title="GauHuman",
    summary="A person animated by SMPL or SMPL-X poses.",
    reads="Reads DIR/cfg_args, DIR/point_cloud/iteration_N/point_cloud.ply, the networks in "
    "DIR/mlp_ckpt/iteration_N/ckpt.pth where they were trained, and the body model that --body "
    "names or DIR/assets holds.",
    inputs=("pose", "root_rotation", "root_translation", "shape", "time"),
    publication=Publication(
        paper="Hu, Hu and Liu 2024",
        arxiv="2312.02973",
        code="https://github.com/skhu101/GauHuman",
        licence="S-Lab licence, non-commercial",
    ),
    recognises=_recognises,
    demo=Demo(write=_write_demo, caption="a motion", view="person"),
    build=build,
)

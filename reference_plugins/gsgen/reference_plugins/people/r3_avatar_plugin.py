"""The command `gsgen export r3-avatar`: exports an R3-Avatar checkpoint as an ONNX generator."""

__all__ = ["PLUGIN"]

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid
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
from gsgen.reference_plugins.loading.options import (
    Checkpoint,
    Fps,
    IterationOption,
    Loop,
    note,
    report_checkpoint,
)
from gsgen.reference_plugins.people.r3_detection import is_r3_run
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.sdk import GaussianGenerator

_MAX_POSES = 100_000

Dataset = Annotated[
    Literal["dna", "zju", "hifi4g", "mvhuman"] | None,
    typer.Option(
        help="Data set of training, which determines the times of poses.",
        show_default="from source_path or exp_name in cfg_args",
    ),
]
PoseIds = Annotated[
    str | None,
    typer.Option(
        "--pose-ids",
        help="Training poses in the model, such as 0-99 or 0,17,50; frame_index selects one.",
        show_default="all with a time",
    ),
]
NovelPoses = Annotated[
    bool,
    typer.Option(
        "--novel-poses",
        help="Give each of five parts of the body a training pose of its own, by inputs.",
    ),
]


def build(
    checkpoint: Checkpoint,
    body: BodyFile = None,
    iteration: IterationOption = None,
    dataset: Dataset = None,
    pose_ids: PoseIds = None,
    shape: Shape = None,
    root_rotation: RootRotation = "matrix",
    hands: HandsOption = "full",
    instances: Instances = 1,
    motion: MotionFile = None,
    fps: Fps = None,
    spacing: Spacing = 1.0,
    *,
    loop: Loop = False,
    novel_poses: NovelPoses = False,
) -> "GaussianGenerator":
    """Read a checkpoint of R3-Avatar, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.bodies.motions import read_motion
    from gsgen.reference_plugins.people.r3_avatar import R3Avatar
    from gsgen.reference_plugins.people.r3_avatar_checkpoint import guess_dataset, read_r3

    for option, is_given in (("--motion", motion is not None), ("--instances", instances > 1)):
        if novel_poses and is_given:
            message = (
                "cannot be combined with --novel-poses: the parts' poses are inputs of one body"
            )
            raise ConfigInvalid(message, where=option, hint="Leave out one of both.")
    read = read_r3(checkpoint, iteration, body, dataset)
    report_checkpoint(read.describe(), read.cfg)
    if dataset is None:
        note(f"note: {read.cfg.path} names the data set {guess_dataset(read.cfg)}")
    warn_about_body(read.cfg, read.body)
    motion_recording = read_motion(motion, read.body.joints) if motion else None
    # Each frame of a motion shows one training frame, so it needs no more of them.
    known = min(2 * read.origin, len(motion_recording)) if motion_recording else 2 * read.origin
    poses = parse_pose_ids(pose_ids) if pose_ids else list(range(known))
    table = 4 * len(poses) * len(read.canonical) / 2**20
    note(f"{len(poses)} frames; the table of nearest vertices takes {table:.1f} MiB")
    avatar = R3Avatar(
        read,
        poses,
        shape=read_shape(shape, motion_recording, read.body.shape_dirs.shape[2]),
        rotation="matrix" if motion_recording else root_rotation,
        bodies=instances,
        add_hands=hands == "raw",
        novel=novel_poses,
        progress=lambda frame: _show_progress(frame, len(poses)),
    )
    return with_motion(
        avatar, avatar.actors, motion_recording, read.body.kind, fps=fps, loop=loop, spacing=spacing
    )


def _show_progress(frame: int, frames: int) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[2Knearest vertices: {frame} of {frames} …")
        if frame == frames:
            sys.stderr.write("\r\x1b[2K")


def parse_pose_ids(text: str) -> list[int]:
    """Parse a list of pose ids such as ``0-9,17``."""
    ids: list[int] = []
    for word in text.split(","):
        first, separator, last = word.strip().partition("-")
        if not (first.isdecimal() and (last.isdecimal() if separator else True)):
            hint = "Write it as 0-99 or 0,17,50."
            raise ConfigInvalid(
                f"{word!r} is no number or range of poses", where="--pose-ids", hint=hint
            )
        listed_ids = range(int(first), int(last or first) + 1)
        if not listed_ids or listed_ids.stop > _MAX_POSES:
            message = f"{word!r} is not an ascending range of pose ids below {_MAX_POSES:,}"
            raise ConfigInvalid(message, where="--pose-ids")
        ids += listed_ids
    return ids


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.bodies.synthetic_body import PersonOptions
    from gsgen.reference_plugins.bodies.synthetic_motion import write_demo_motion
    from gsgen.reference_plugins.people.synthetic_people import write_r3

    write_r3(folder, PersonOptions(count=6000, vertices=3000, nets=True))
    return write_demo_motion(folder)


PLUGIN = Plugin(
    name="r3-avatar",
    words="r3avatar avatar",
    title="R3-Avatar",
    summary="A person whose appearance changes from frame to frame.",
    reads="Reads DIR/cfg_args, DIR/chkpntN.pth and the body model that --body names or "
    "DIR/assets holds.",
    inputs=("pose", "root_rotation", "root_translation", "frame_index", "shape", "time"),
    publication=Publication(
        paper="Zhan et al. 2025",
        arxiv="2503.12751",
        code="https://github.com/Yifever20002/R3Avatars",
        licence="MIT",
    ),
    recognises=lambda run, iteration: is_r3_run(run),
    demo=Demo(write=_write_demo, caption="a motion", view="person"),
    build=build,
)

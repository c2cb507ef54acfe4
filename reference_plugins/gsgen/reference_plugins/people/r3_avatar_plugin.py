"""`gsgen export r3-avatar`: a checkpoint of R3-Avatar as a generator."""

__all__ = ["PLUGIN"]

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid
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
from gsgen.reference_plugins.loading.options import (
    Checkpoint,
    Fps,
    Iteration,
    Loop,
    note,
    report_checkpoint,
)
from gsgen.reference_plugins.people.r3_detection import is_r3_run
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.sdk import GaussianGenerator

_MOST_POSES = 100_000

Dataset = Annotated[
    Literal["dna", "zju", "hifi4g", "mvhuman"] | None,
    typer.Option(
        help="Whose data it was trained on: that says how poses are timed.",
        show_default="as source_path or exp_name in cfg_args says",
    ),
]
PoseIds = Annotated[
    str | None,
    typer.Option(
        "--pose-ids",
        help="Which poses of training can be asked for, such as 0-99 or 0,17,50; frame_index "
        "counts them.",
        show_default="all of which time knows",
    ),
]


def build(
    checkpoint: Checkpoint,
    body: BodyFile = None,
    iteration: Iteration = None,
    dataset: Dataset = None,
    pose_ids: PoseIds = None,
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
    from gsgen.reference_plugins.people.r3_avatar import R3Avatar
    from gsgen.reference_plugins.people.r3_avatar_checkpoint import guessed_dataset, read_r3

    read = read_r3(checkpoint, iteration, body, dataset)
    report_checkpoint(read.describe(), read.cfg)
    if dataset is None:
        note(f"note: by {read.cfg.path} its data are of {guessed_dataset(read.cfg)}")
    warn_of_body(read.cfg, read.body)
    told = read_motion(motion, read.body.joints) if motion else None
    # A motion shows a frame of training with each of its own, so it needs no more.
    known = min(2 * read.origin, len(told)) if told else 2 * read.origin
    poses = ids_of(pose_ids) if pose_ids else list(range(known))
    table = 4 * len(poses) * len(read.canonical) / 2**20
    note(f"{len(poses)} frames; which vertices are nearest takes {table:.1f} MiB")
    avatar = R3Avatar(
        read,
        poses,
        shape=read_shape(shape, told, read.body.shape_dirs.shape[2]),
        rotation="matrix" if told else root_rotation,
        bodies=instances,
        add_hands=hands == "raw",
        progress=lambda frame: _say(frame, len(poses)),
    )
    return played(
        avatar, avatar.actors, told, read.body, fps=fps, loop=loop, spacing=spacing
    )


def _say(frame: int, frames: int) -> None:
    """Show how far the search for nearest vertices is, where someone is watching."""
    if sys.stderr.isatty():
        typer.echo(f"\r\x1b[2Knearest vertices: {frame} of {frames} …", err=True, nl=False)
        if frame == frames:
            typer.echo("\r\x1b[2K", err=True, nl=False)


def ids_of(text: str) -> list[int]:
    """Return the numbers that a list such as ``0-9,17`` means.

    Raises:
        ConfigInvalid: It is no such list.
    """
    made: list[int] = []
    for word in text.split(","):
        first, dash, last = word.strip().partition("-")
        if not (first.isdecimal() and (last.isdecimal() if dash else True)):
            hint = "Write it as 0-99 or 0,17,50."
            raise ConfigInvalid(f"{word!r} is no pose", where="--pose-ids", hint=hint)
        listed = range(int(first), int(last or first) + 1)
        if not listed or listed.stop > _MOST_POSES:
            what = f"{word!r} is no range of poses below {_MOST_POSES:,}"
            raise ConfigInvalid(what, where="--pose-ids")
        made += listed
    return made


def _recognises(run: Path, iteration: Path) -> bool:
    """Whether some ``chkpntN.pth`` holds the decoder of R3-Avatar."""
    return is_r3_run(run)


def _write_demo(folder: Path) -> list[str]:
    """Write a checkpoint of a person, and a motion to play."""
    from gsgen.reference_plugins.bodies.synthetic_body import PersonOptions
    from gsgen.reference_plugins.bodies.synthetic_motion import write_motion
    from gsgen.reference_plugins.people.synthetic_people import write_r3

    write_r3(folder, PersonOptions(count=6000, vertices=3000, nets=True))
    motion = write_motion(folder / "walk.npz", frames=24)
    return ["--checkpoint", str(folder), "--motion", str(motion)]


PLUGIN = Plugin(
    name="r3-avatar",
    title="R3-Avatar",
    summary="A person whose look changes from frame to frame.",
    reads="Reads DIR/cfg_args, DIR/chkpntN.pth and the body model that --body names or "
    "DIR/assets holds.",
    inputs=("pose", "root_rotation", "root_translation", "frame_index", "shape", "time"),
    publication=Publication(
        paper="Zhan et al. 2025",
        arxiv="2503.12751",
        code="https://github.com/Yifever20002/R3Avatars",
        licence="MIT",
    ),
    recognises=_recognises,
    demo=Demo(write=_write_demo, caption="a motion", view="person"),
    build=build,
)

"""The command `gsgen export gart`: exports a GART avatar as an ONNX generator."""

__all__ = ["PLUGIN"]

from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.reference_plugins.bodies.options import Instances, MotionFile, Spacing, with_motion
from gsgen.reference_plugins.loading.options import Checkpoint, Fps, Loop, note
from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication

if TYPE_CHECKING:
    from gsgen.sdk import GaussianGenerator


def build(
    checkpoint: Checkpoint,
    instances: Instances = 1,
    motion: MotionFile = None,
    fps: Fps = None,
    spacing: Spacing = 1.0,
    *,
    loop: Loop = False,
) -> "GaussianGenerator":
    """Read a checkpoint of GART, report its contents, and return a Gaussian generator."""
    from gsgen.reference_plugins.bodies.motions import read_motion
    from gsgen.reference_plugins.people.gart import Gart
    from gsgen.reference_plugins.people.gart_checkpoint import read_gart

    read = read_gart(checkpoint)
    note(read.describe())
    avatar = Gart(read, bodies=instances)
    recording = read_motion(motion, len(read.joints)) if motion else None
    return with_motion(
        avatar, avatar.actors, recording, "SMPL", fps=fps, loop=loop, spacing=spacing
    )


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.bodies.synthetic_body import PersonOptions
    from gsgen.reference_plugins.bodies.synthetic_motion import write_demo_motion
    from gsgen.reference_plugins.people.synthetic_people import write_gart

    person = PersonOptions(count=6000, vertices=3000, degree=1)
    write_gart(folder, person, resolution=64, noise=0.004)
    return write_demo_motion(folder)


PLUGIN = Plugin(
    name="gart",
    words="smal dog animal",
    title="GART",
    summary="A person with joints of SMPL and additional bones.",
    reads="Reads DIR/model.pth and the profile of the training, DIR/*.yaml, as GART's solver "
    "writes them; no body model.",
    inputs=("pose", "root_translation", "frame_index", "view", "time"),
    publication=Publication(
        paper="Lei et al. 2024",
        arxiv="2311.16099",
        code="https://github.com/JiahuiLei/GART",
        licence="MIT",
    ),
    demo=Demo(write=_write_demo, caption="a motion", view="person"),
    build=build,
)

"""Command-line options that all plugins for avatars and heads share."""

__all__ = [
    "BodyFile", "HandsOption", "Instances", "MotionFile", "RootRotation", "Shape", "Spacing",
    "parse_numbers", "read_shape", "warn_about_body", "with_motion",
]  # fmt: skip

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.loading.options import note, warn_unsupported

if TYPE_CHECKING:
    from gsgen.reference_plugins.bodies.actors import PersonInputs
    from gsgen.reference_plugins.bodies.body_models import Body
    from gsgen.reference_plugins.bodies.motions import Motion
    from gsgen.reference_plugins.loading.cfg_args import CfgArgs
    from gsgen.sdk import GaussianGenerator

BodyFile = Annotated[
    Path | None,
    typer.Option(
        "--body",
        help="Body model: a file of SMPL (.pkl, .npz) or SMPL-X (.npz) from its website.",
        show_default="the one under assets",
    ),
]
Instances = Annotated[
    int, typer.Option(help="Number of copies of the person, each with its own inputs.", min=1)
]
RootRotation = Annotated[
    Literal["matrix", "axis-angle"], typer.Option(help="Convention of the root rotation input.")
]
Shape = Annotated[
    str | None,
    typer.Option(
        "--shape",
        help="Shape coefficients to bake, such as 0.4,-1.2; fewer are filled with zeros.",
        show_default="an input",
    ),
]
MotionFile = Annotated[
    Path | None,
    typer.Option(
        "--motion",
        help="Bake a motion, so that time moves the body: an .npz of AMASS, a folder of .npz "
        "or .npy with R or Rh, Th and poses, LHM's .json files, or GART's training_poses.pth.",
        show_default="poses are inputs",
    ),
]
Spacing = Annotated[
    float, typer.Option(help="Distance between instances that play a motion, along x.")
]
HandsOption = Annotated[
    Literal["full", "raw"],
    typer.Option(
        help="Whether poses of SMPL-X include the mean pose of the hands (full) or not (raw)."
    ),
]


def warn_about_body(cfg: "CfgArgs", body: "Body") -> None:
    """Warn if a method's published code would use another body model than the given file."""
    if not cfg.file_exists:
        note(f"note: {cfg.path} does not exist; a neutral {body.kind} body is assumed")
    if body.kind == "SMPL":
        meaning_text = (
            "the published code always takes the training pose from SMPL_NEUTRAL.pkl; "
            "gsgen uses the body model that was read"
        )
        warn_unsupported(cfg, {"actor_gender": ("neutral", meaning_text)})


def read_shape(text: str | None, motion: "Motion | None", max_count: int) -> list[float] | None:
    """Return the body-shape coefficients to store as constants: of --shape, else of the motion file."""
    coefficients = parse_numbers(text, max_count, "--shape")
    if coefficients is not None or motion is None:
        return coefficients
    if motion.shape is None:
        note("note: the motion has no shape coefficients: they are zero without --shape")
        return [0.0] * max_count
    motion_shape: Sequence[float] = motion.shape[:max_count].tolist()
    return [*motion_shape, *[0.0] * (max_count - len(motion_shape))]


def with_motion(
    avatar: "GaussianGenerator",
    actors: "PersonInputs",
    motion: "Motion | None",
    body_kind: str,
    *,
    fps: float | None,
    loop: bool,
    spacing: float,
) -> "GaussianGenerator":
    """Wrap an avatar so that it plays a motion file, if given, and add the motion's licence."""
    from importlib.metadata import version

    from gsgen.contract.spec.manifest import Producer
    from gsgen.reference_plugins.bodies.motion_playback import MotionPlayback
    from gsgen.sdk import inputs

    if motion is None and (fps is not None or loop):
        message = "--fps and --loop need a motion"
        raise ConfigInvalid(message, where="--fps, --loop", hint="Add --motion FILE.")
    if motion is not None:
        note(motion.describe())
        time = inputs.time(frames=len(motion), fps=fps or motion.fps, loop=loop or None)
        avatar = MotionPlayback(avatar, actors, motion, time, spacing=spacing)
    note(f"note: the model holds parts of {body_kind}, whose licence forbids redistribution")
    license_name = f"LicenseRef-{body_kind}-derived-no-redistribution"
    avatar.producer = Producer(f"gsgen {version('gsgen')}", license=license_name)
    return avatar


def parse_numbers(text: str | None, max_count: int, option: str) -> list[float] | None:
    """Parse a comma-separated list of numbers, padded with zeros to a fixed length."""
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError as error:
        hint = f"Write it as {option} 0.4,-1.2."
        message = f"{text!r} is not a list of numbers"
        raise ConfigInvalid(message, where=option, hint=hint) from error
    if len(numbers) > max_count or not all(abs(number) < 1e6 for number in numbers):
        message = f"gives {len(numbers)} numbers, expected up to {max_count}, all finite"
        raise ConfigInvalid(message, where=option)
    return numbers + [0.0] * (max_count - len(numbers))

"""Options that the plugins of people share."""

__all__ = [
    "BodyFile",
    "Hands",
    "Instances",
    "MotionFile",
    "RootRotation",
    "Shape",
    "Spacing",
    "numbers_of",
    "played",
    "read_shape",
    "warn_of_body",
]

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.loading.options import note, warn_unsupported

if TYPE_CHECKING:
    from gsgen.reference_plugins.bodies.actors import ActorInputs
    from gsgen.reference_plugins.bodies.body_models import Body
    from gsgen.reference_plugins.bodies.motions import Motion
    from gsgen.reference_plugins.loading.cfg_args import CfgArgs
    from gsgen.sdk import GaussianGenerator

BodyFile = Annotated[
    Path | None,
    typer.Option(
        "--body",
        help="The body model: a file of SMPL (.pkl, .npz) or SMPL-X (.npz), from its makers.",
        show_default="the one under assets",
    ),
]
Instances = Annotated[
    int, typer.Option(help="How many of the person there are, each with its inputs.", min=1)
]
RootRotation = Annotated[
    Literal["matrix", "axis-angle"],
    typer.Option(help="How the rotation of the body as a whole is given."),
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
        "or .npy with R or Rh, Th and poses, or LHM's .json files.",
        show_default="poses are inputs",
    ),
]
Spacing = Annotated[
    float, typer.Option(help="How far instances that play a motion stand apart, along x.")
]
Hands = Annotated[
    Literal["full", "raw"],
    typer.Option(
        help="Whether poses of SMPL-X have the mean pose of the hands in them (full) or not (raw)."
    ),
]


def warn_of_body(cfg: "CfgArgs", body: "Body") -> None:
    """Say where the published code takes another body model than the one that is given."""
    if not cfg.present:
        note(f"note: there is no {cfg.path}; a neutral {body.kind} body is assumed")
    if body.kind == "SMPL":
        meaning = (
            "the published code takes the pose of training from SMPL_NEUTRAL.pkl whatever it "
            "says; here all is taken from the body model that was read"
        )
        warn_unsupported(cfg, {"actor_gender": ("neutral", meaning)})


def read_shape(text: str | None, motion: "Motion | None", most: int) -> list[float] | None:
    """Return the shape to bake: the one given, else that of the motion; none if it is an input.

    Raises:
        ConfigInvalid: ``text`` is no list of numbers.
    """
    given = numbers_of(text, most, "--shape")
    if given is not None or motion is None:
        return given
    if motion.shape is None:
        note(
            "note: the motion does not name the person's shape: it is zero without --shape"
        )
        return [0.0] * most
    taken: Sequence[float] = motion.shape[:most].tolist()
    return [*taken, *[0.0] * (most - len(taken))]


def played(
    avatar: "GaussianGenerator",
    actors: "ActorInputs",
    motion: "Motion | None",
    body: "Body",
    *,
    fps: float | None,
    loop: bool,
    spacing: float,
) -> "GaussianGenerator":
    """Return ``avatar``, or what plays ``motion`` with it; say so, and whose licence it is under.

    Raises:
        ConfigInvalid: An option needs a motion.
        CheckpointInvalid: The motion is of another body.
    """
    from importlib.metadata import version

    from gsgen.contract.spec.manifest import Producer
    from gsgen.reference_plugins.bodies.motion_playback import Played
    from gsgen.sdk import inputs

    if motion is None and (fps is not None or loop):
        what = "only a motion has a speed and an end"
        raise ConfigInvalid(what, where="--fps, --loop", hint="Give --motion FILE, too.")
    if motion is not None:
        note(motion.describe())
        time = inputs.time(frames=len(motion), fps=fps or motion.fps, loop=loop or None)
        avatar = Played(avatar, actors, motion, time, spacing=spacing)
    note(f"note: the model holds parts of {body.kind}, whose licence forbids to pass it on")
    license_name = f"LicenseRef-{body.kind}-derived-no-redistribution"
    avatar.producer = Producer(f"gsgen {version('gsgen')}", license=license_name)
    return avatar


def numbers_of(text: str | None, most: int, option: str) -> list[float] | None:
    """Return the numbers that ``text`` lists, filled with zeros to ``most``; none for none.

    Raises:
        ConfigInvalid: A word is no number, or there are too many.
    """
    if text is None:
        return None
    try:
        made = [float(word) for word in text.split(",")]
    except ValueError as error:
        hint = f"Write it as {option} 0.4,-1.2."
        raise ConfigInvalid(
            f"{text!r} is no list of numbers", where=option, hint=hint
        ) from error
    if len(made) > most or not all(abs(one) < 1e6 for one in made):
        what = f"gives {len(made)} numbers, wanted up to {most}, all finite"
        raise ConfigInvalid(what, where=option)
    return made + [0.0] * (most - len(made))

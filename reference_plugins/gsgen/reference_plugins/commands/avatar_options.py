"""Options that the plugins of people share."""

__all__ = ["BodyFile", "Instances", "RootRotation", "Shape", "numbers_of"]

from pathlib import Path
from typing import Annotated, Literal

import typer

from gsgen.contract.errors import ConfigInvalid

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
        mend = f"Write it as {option} 0.4,-1.2."
        raise ConfigInvalid(f"{text!r} is no list of numbers", where=option, mend=mend) from error
    if len(made) > most or not all(abs(one) < 1e6 for one in made):
        what = f"gives {len(made)} numbers, wanted up to {most}, all finite"
        raise ConfigInvalid(what, where=option)
    return made + [0.0] * (most - len(made))

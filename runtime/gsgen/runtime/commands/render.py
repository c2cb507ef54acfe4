"""`gsgen render`: splat files and generators as pictures."""

__all__ = ["render"]

import json
import time as clock
import warnings
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

from gsgen.contract.errors import ConfigInvalid, ModelUnreadable

if TYPE_CHECKING:
    from gsgen.runtime.film import Film
    from gsgen.runtime.pictures import Mode
    from gsgen.runtime.sources import Source

_UNREADABLE = 4


class ModeName(StrEnum):
    """What can be shown; both spellings of colour are understood."""

    COLOR = "color"
    COLOUR = "colour"
    DEPTH = "depth"
    MEDIAN_DEPTH = "median-depth"
    NORMAL = "normal"
    ALPHA = "alpha"

    @property
    def shown(self) -> "Mode":
        """The mode that is meant."""
        if self is ModeName.COLOUR:
            return "color"
        return cast("Mode", self.value)


def render(
    scenes: Annotated[
        list[Path],
        typer.Argument(
            help="Splat files and ONNX generators; several are one scene.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="A picture, an .npy of floats, an .mp4, a .gif, or a folder for several frames.",
            show_default=False,
        ),
    ],
    camera: Annotated[
        str | None,
        typer.Option(
            help="orbit[:AZIMUTH,ELEVATION[,RADIUS]], look-at:EX,EY,EZ,TX,TY,TZ, or a JSON file "
            "of one camera or a list. [default: an orbit from where everything is seen]"
        ),
    ] = None,
    width: Annotated[
        int | None, typer.Option(help="Pixels. [default: the camera's, or 1280]", min=1)
    ] = None,
    height: Annotated[
        int | None, typer.Option(help="Pixels. [default: the camera's, or 720]", min=1)
    ] = None,
    fov: Annotated[float, typer.Option(help="Vertical field of view, in degrees.")] = 50.0,
    up: Annotated[
        Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None,
        typer.Option(help="Which axis points up. [default: the manifest's, or -y]"),
    ] = None,
    orthographic: Annotated[
        bool,
        typer.Option(
            "--orthographic", help="No perspective; the middle is as large as with."
        ),
    ] = False,
    mode: Annotated[
        ModeName, typer.Option(help="What to show.", case_sensitive=False)
    ] = ModeName.COLOR,
    background: Annotated[
        str | None,
        typer.Option(
            help="black, white, transparent, #rrggbb or R,G,B[,A] from 0 to 1. "
            "[default: black; transparent for .npy]"
        ),
    ] = None,
    time: Annotated[
        float | None, typer.Option(help="For generators. [default: the manifest's]")
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            help="How many. Time goes through its range; if nothing has a time, an orbit turns. "
            "[default: one a camera]",
            min=1,
        ),
    ] = None,
    turn: Annotated[
        float | None,
        typer.Option(
            help="Degrees that an orbit turns over all frames. [default: 360 or 0]"
        ),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(help="Of a film. [default: the manifest's, or 25]", min=0.1, max=100),
    ] = None,
    sh_degree: Annotated[
        int | None,
        typer.Option(help="Use no harmonics above this degree.", min=0, max=3),
    ] = None,
    antialias: Annotated[
        Literal["classic", "mip"] | None,
        typer.Option(
            help="How the scene was trained. [default: the manifest's, or classic]"
        ),
    ] = None,
    provider: Annotated[
        Literal["auto", "cpu", "webgpu", "cuda"],
        typer.Option(help="What ONNX Runtime runs generators on."),
    ] = "cpu",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print what was drawn as JSON.")
    ] = False,
) -> None:
    """Draw SCENES: splat files, and generators that are run for every frame.

    Exits 0 if everything was written, 2 for wrong options, 4 if a scene cannot be read.
    """
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.runtime.film import Film
    from gsgen.runtime.viewpoint import viewpoint

    view = viewpoint(camera, width, height, fov, up, orthographic)
    behind = _background(background, output)
    sources = _opened(scenes, provider)
    try:
        film = Film(
            sources,
            view,
            mode.shown,
            background=behind,
            sh_degree=sh_degree,
            antialias=antialias,
            time=time,
            frames=frames,
            turn=turn,
        )
        began = clock.perf_counter()
        film.write(output, fps, lambda number: progress(f"frame {number} of {film.frames}"))
        clear()
        _report(film, output, clock.perf_counter() - began, as_json)
    finally:
        for source in sources:
            source.close()


def _opened(scenes: list[Path], provider: str) -> list["Source"]:
    """Open every scene; what a session warns of becomes notes."""
    from gsgen.runtime.errors import SceneUnreadable
    from gsgen.runtime.sources import open_source

    made: list[Source] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        try:
            for path in scenes:
                made.append(open_source(path, provider))
        except (ModelUnreadable, SceneUnreadable) as error:
            typer.echo(f"gsgen: {error}", err=True)
            raise typer.Exit(_UNREADABLE) from error
    for warning in caught:
        typer.echo(f"note: {warning.message}", err=True)
    return made


def _background(text: str | None, output: Path) -> tuple[float, float, float, float]:
    named = {
        "black": (0.0, 0.0, 0.0, 1.0),
        "white": (1.0, 1.0, 1.0, 1.0),
        "transparent": (0.0, 0.0, 0.0, 0.0),
    }
    if text is None:
        return named["transparent" if output.suffix.lower() == ".npy" else "black"]
    if text.lower() in named:
        return named[text.lower()]
    try:
        if text.startswith("#") and len(text) == 7:
            hexed = bytes.fromhex(text[1:])
            return hexed[0] / 255, hexed[1] / 255, hexed[2] / 255, 1.0
        red, green, blue, *rest = (float(one) for one in text.split(","))
        (alpha,) = rest or (1.0,)
        if not all(0 <= one <= 1 for one in (red, green, blue, alpha)):
            raise ValueError(text)
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r} is no colour",
            where="--background",
            mend="Give black, white, transparent, #rrggbb or R,G,B[,A] from 0 to 1.",
        ) from error
    return red, green, blue, alpha


def _report(film: "Film", output: Path, seconds: float, as_json: bool) -> None:
    said = film.summary() | {"output": str(output), "seconds": round(seconds, 3)}
    if as_json:
        typer.echo(json.dumps(said, indent=2))
        return
    count = f"{film.frames} frames of " if film.frames > 1 else ""
    typer.echo(
        f"{output}: {count}{said['width']}×{said['height']}, "
        f"{said['visible']:,} of {said['gaussians']:,} Gaussians drawn, "
        f"{seconds:.2f} s on {said['device']}"
    )
    if not said["visible"]:
        typer.echo("note: no Gaussian is in front of the camera", err=True)

"""`gsgen render`: splat files and generators as pictures."""

__all__ = ["ModeName", "fed", "render"]

import json
import time as clock
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.commands.options import (
    Antialias,
    Axis,
    Compact,
    FieldOfView,
    Height,
    Post,
    Provider,
    RasteriserName,
    Scenes,
    ShDegree,
    Sizes,
    Width,
)

if TYPE_CHECKING:
    from gsgen.runtime.media.pictures import Mode
    from gsgen.runtime.playback.frame_sequence import FrameSequence
    from gsgen.runtime.playback.input_tracks import Track
    from gsgen.runtime.sources.scene_file import SceneFile
    from gsgen.runtime.sources.source import Source


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
    scenes: Scenes,
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
            help="orbit[:AZIMUTH,ELEVATION[,RADIUS]], look-at:EX,EY,EZ,TX,TY,TZ, or a file or "
            "folder of cameras; #NAME or #NUMBER after it picks one. "
            "[default: an orbit from where everything is seen]"
        ),
    ] = None,
    width: Width = None,
    height: Height = None,
    fov: FieldOfView = None,
    up: Axis = None,
    orthographic: Annotated[
        bool,
        typer.Option(
            "--orthographic", help="No perspective; the middle is as large as with."
        ),
    ] = False,
    panorama: Annotated[
        bool,
        typer.Option(
            "--panorama",
            help="All around, equirectangular: from the middle, or where the camera is.",
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
    pose: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]FILE",
            help="Poses, frame after frame: .npy, .npz or .json of [J,3] or [F,J,3], an .npz of "
            "AMASS, LHM's .json, or a folder of such files; repeatable.",
        ),
    ] = None,
    inputs: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="NAME=VALUE",
            help="Another input, by its name or role: a number, A,B,…, FROM..TO, or a file; "
            "repeatable.",
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            help="How many. Time, or else a frame number, goes through its range; if nothing "
            "moves, an orbit turns. [default: one a camera, a pose or a value]",
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
    sh_degree: ShDegree = None,
    antialias: Antialias = None,
    rasteriser: RasteriserName = "auto",
    compact: Compact = False,
    wsr: Annotated[
        Literal["contract", "published"],
        typer.Option(
            help="How a background counts in weighted sums: as the contract says, or as in the "
            "renderer that came with the method."
        ),
    ] = "contract",
    post: Post = None,
    size: Sizes = None,
    provider: Provider = "cpu",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print what was drawn as JSON.")
    ] = False,
) -> None:
    """Draw SCENES: splat files and meshes, and generators that are run for every frame.

    A scene.json says where each stands, and from where they are seen; options count more than it.

    Exits 0 if everything was written, 2 for wrong options, 4 if a scene cannot be read.
    """
    from gsgen.contract.commands.progress import clear, progress
    from gsgen.runtime.commands.opening import opened, scene_files
    from gsgen.runtime.playback.frame_sequence import FrameSequence
    from gsgen.runtime.playback.scene_camera import scene_view
    from gsgen.runtime.renderer.renderer import Renderer
    from gsgen.sdk.commands.sizes import sizes_of

    files = list(scene_files(scenes).values())
    view = scene_view(files, camera, width, height, fov, up, orthographic, panorama)
    behind = _background(background, output, files)
    for note in (*view.notes, *_of_transparency(output, behind, mode.shown)):
        typer.echo(f"note: {note}", err=True)
    sizes = sizes_of(size, "--size")
    with opened(scenes, post or (), provider=provider, sizes=sizes) as (sources, models):
        tracks, speed = fed(pose, inputs, sources)
        if wsr == "published":
            _require_sums(sources)
        film = FrameSequence(
            sources,
            view,
            mode.shown,
            background=behind,
            sh_degree=sh_degree,
            antialias=antialias,
            time=time,
            frames=frames,
            turn=turn,
            tracks=tracks,
            post=models,
            renderer=Renderer(
                rasteriser=rasteriser, compact=compact, published=wsr == "published"
            ),
        )
        started = clock.perf_counter()
        film.write(
            output,
            fps or speed,
            lambda number: progress(f"frame {number} of {film.frames}"),
        )
        clear()
        _report(film, output, clock.perf_counter() - started, as_json)


def fed(
    poses: list[str] | None, inputs: list[str] | None, sources: "list[Source]"
) -> "tuple[list[Track], float | None]":
    """Return what inputs are fed, and frames a second if a file of poses says so."""
    from gsgen.runtime.playback.input_tracks import input_track
    from gsgen.runtime.playback.pose_tracks import named_file, pose_tracks

    tracks: list[Track] = []
    fps: float | None = None
    for text in poses or ():
        word = named_file(text)[0]
        takers = [source for source in sources if source.named(word)]
        if not takers:
            raise ConfigInvalid(f"no scene has an input {word!r}", where=f"--pose {text}")
        pose_values, speed = pose_tracks(text, takers[0])
        tracks, fps = [*tracks, *pose_values], fps or speed
    return [*tracks, *(input_track(text) for text in inputs or ())], fps


def _require_sums(sources: "list[Source]") -> None:
    """Refuse what the published form of weighted sums is not defined for."""
    unsummed = next(
        (source for source in sources if source.weighted is None or source.meshes), None
    )
    if unsummed is not None:
        raise ConfigInvalid(
            f"{unsummed.name} is not blended by weighted sums, and nothing else can be drawn so",
            where="--wsr published",
            hint="Leave it out, or draw all of it as the contract says: `--wsr contract`.",
        )


def _background(
    text: str | None, output: Path, files: "list[SceneFile]"
) -> tuple[float, float, float, float]:
    from gsgen.runtime.playback.scene_camera import told
    from gsgen.runtime.scene.colors import color_of

    if text is None and told(files, "background") is not None:
        return cast("tuple[float, float, float, float]", told(files, "background"))
    if text is None:
        text = "transparent" if output.suffix.lower() == ".npy" else "black"
    return color_of(text, "--background")


def _of_transparency(
    output: Path, behind: tuple[float, float, float, float], mode: "Mode"
) -> list[str]:
    """Say what becomes of a background that can be seen through, where the format cannot."""
    from gsgen.runtime.media.pictures import OPAQUE

    suffix = output.suffix.lower()
    if behind[3] == 1 or mode != "color":
        return []
    if suffix in OPAQUE:
        return [f"{suffix} has no transparency: the background is blended with black"]
    if suffix == ".gif":
        return [
            "pixels of a .gif are transparent or not: opaque is what is covered by half or more; "
            "a folder of pictures keeps all of it"
        ]
    return []


def _report(film: "FrameSequence", output: Path, seconds: float, as_json: bool) -> None:
    document = film.summary() | {"output": str(output), "seconds": round(seconds, 3)}
    if as_json:
        typer.echo(json.dumps(document, indent=2))
        return
    count = f"{film.frames} frames of " if film.frames > 1 else ""
    triangles = f"{document['triangles']:,} triangles, " if document["triangles"] else ""
    typer.echo(
        f"{output}: {count}{document['width']}×{document['height']}, "
        f"{document['visible']:,} of {document['gaussians']:,} Gaussians drawn, {triangles}"
        f"{seconds:.2f} s on {document['device']}"
    )
    if document["gaussians"] and not document["visible"]:
        typer.echo(
            "note: no Gaussian is seen: none is in front of the camera and opaque", err=True
        )

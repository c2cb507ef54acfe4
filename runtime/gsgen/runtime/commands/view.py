"""`gsgen view`: splat files and generators in a window."""

__all__ = ["view"]

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.runtime.commands.options import (
    Antialias,
    Axis,
    Compact,
    FieldOfView,
    Post,
    Provider,
    RasteriserName,
    Scenes,
    ShDegree,
    Sizes,
)
from gsgen.runtime.commands.render import ModeName, fed

if TYPE_CHECKING:
    from gsgen.runtime.viewer.live_playback import LivePlayback


def view(
    scenes: Scenes,
    camera: Annotated[
        str | None,
        typer.Option(
            help="Location it begins: as for render. [default: from where everything is seen]"
        ),
    ] = None,
    width: Annotated[
        int | None,
        typer.Option(help="Of the window. [default: the camera's, or 1280]", min=1),
    ] = None,
    height: Annotated[
        int | None,
        typer.Option(help="Of the window. [default: the camera's, or 720]", min=1),
    ] = None,
    fov: FieldOfView = None,
    up: Axis = None,
    orthographic: Annotated[
        bool, typer.Option("--orthographic", help="No perspective.")
    ] = False,
    panorama: Annotated[
        bool, typer.Option("--panorama", help="All around, equirectangular.")
    ] = False,
    mode: Annotated[
        ModeName, typer.Option(help="What is first shown.", case_sensitive=False)
    ] = ModeName.COLOR,
    background: Annotated[
        str | None,
        typer.Option(
            help="black, white, #rrggbb or R,G,B from 0 to 1. [default: the scene's, or black]"
        ),
    ] = None,
    time: Annotated[
        float | None,
        typer.Option(help="Of generators; it then stands still. [default: it is played]"),
    ] = None,
    pose: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]FILE", help="Poses: as for render; repeatable."),
    ] = None,
    inputs: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="NAME=VALUE",
            help="Another input: as for render; repeatable.",
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            help="How many steps the slider has. [default: one a pose or a value, or 100]",
            min=2,
        ),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Steps that pass in a second. [default: the manifest's, or 25]",
            min=0.1,
            max=1000,
        ),
    ] = None,
    play: Annotated[
        bool, typer.Option("--play/--no-play", help="Whether time goes on at once.")
    ] = True,
    sh_degree: ShDegree = None,
    antialias: Antialias = None,
    rasteriser: RasteriserName = "auto",
    compact: Compact = False,
    post: Post = None,
    size: Sizes = None,
    provider: Provider = "cpu",
    pictures: Annotated[
        Path, typer.Option(help="The folder where pictures are saved.")
    ] = Path(),
) -> None:
    """Show SCENES in a window: turn them about, play their time, and save pictures of them.

    The window says with H which keys there are; files may be dropped on it.

    Exits 0 when it is closed, 2 for wrong options or where there is no screen, 4 if a scene cannot be read.
    """
    from gsgen.runtime.commands.opening import opened, scene_files
    from gsgen.runtime.errors import DisplayUnavailable
    from gsgen.runtime.playback.scene_camera import scene_view, told
    from gsgen.runtime.scene.colors import color_of
    from gsgen.runtime.viewer.live_playback import LivePlayback
    from gsgen.runtime.viewer.surface_renderer import SurfaceRenderer
    from gsgen.runtime.viewer.viewer import Viewer
    from gsgen.runtime.viewer.window import open_window, require_display
    from gsgen.sdk.commands.sizes import sizes_of

    try:
        require_display()
    except DisplayUnavailable as error:
        words = shlex.join(["gsgen", "render", *map(str, scenes), "-o", "view.png"])
        hint = error.hint or f"Without a screen: {words}"
        raise DisplayUnavailable(error.message, hint=hint) from error
    files = list(scene_files(scenes).values())
    viewpoint = scene_view(files, camera, width, height, fov, up, orthographic, panorama)
    for note in viewpoint.notes:
        typer.echo(f"note: {note}", err=True)
    behind = told(files, "background") or (0.0, 0.0, 0.0, 1.0)
    if background is not None:
        behind = color_of(background, "--background")
    with opened(scenes, post or (), provider=provider, sizes=sizes_of(size, "--size")) as (
        sources,
        models,
    ):
        tracks, speed = fed(pose, inputs, sources)
        stage = LivePlayback(
            sources,
            post=models,
            tracks=tracks,
            time=time,
            frames=frames,
            fps=fps or speed,
            sh_degree=sh_degree,
            antialias=antialias,
        )
        stage.playing = play and stage.frames > 1
        viewer = Viewer(
            stage,
            viewpoint,
            painter=SurfaceRenderer(rasteriser=rasteriser, compact=compact),
            mode=mode.shown,
            background=behind,
            folder=pictures,
            say=typer.echo,
            reopen=_reopener(play),
        )
        home = viewpoint.camera(sources[0], 0, 0.0)
        try:
            open_window(viewer, _title(scenes), (home.width, home.height))
        finally:
            viewer.stage.close()


def _title(scenes: Sequence[Path]) -> str:
    return ", ".join(path.name for path in scenes) + " - gsgen"


def _reopener(play: bool) -> "Callable[[Sequence[Path]], LivePlayback]":
    """Return what opens files that are dropped on the window."""
    from gsgen.runtime.sources.scene_source import sources_of
    from gsgen.runtime.viewer.live_playback import LivePlayback

    def reopen(paths: Sequence[Path]) -> LivePlayback:
        stage = LivePlayback(sources_of(list(paths)))
        stage.playing = play and stage.frames > 1
        return stage

    return reopen

"""`gsgen view`: shows splat files and ONNX generators in a window."""

__all__ = ["view"]

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gsgen.cli.commands.drawing import options
from gsgen.cli.commands.drawing.streaming_options import with_streaming_options
from gsgen.cli.output import echo, echo_json
from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.sources.stream_settings import StreamSettings

if TYPE_CHECKING:
    from gsgen.contract.process.limits import Limits
    from gsgen.runtime.playback.live_playback import LivePlayback
    from gsgen.runtime.scene.camera import Camera
    from gsgen.runtime.sources.scene_file import SceneFile
    from gsgen.runtime.viewer.viewer import Viewer
    from gsgen.runtime.web.pages import ModelView, SplatReader

WindowWidth = Annotated[
    int | None, typer.Option(help="Width of the window. [default: the camera's, or 1280]", min=1)
]
WindowHeight = Annotated[
    int | None, typer.Option(help="Height of the window. [default: the camera's, or 720]", min=1)
]
Background = Annotated[
    str | None,
    typer.Option(
        help="black, white, #rrggbb or R,G,B from 0 to 1. [default: the scene's, or black]"
    ),
]
Time = Annotated[
    float | None, options.time_option("Fixed time of generators. [default: the time is played]")
]
Frames = Annotated[
    int | None,
    typer.Option(
        help="Number of steps of the slider. [default: one per pose or value, or 100]", min=2
    ),
]
FramesPerSecond = Annotated[
    float | None,
    typer.Option(help="Steps per second. [default: the manifest's, or 25]", min=0.1, max=1000),
]
PlayOption = Annotated[
    bool, typer.Option("--play/--no-play", help="Whether the window opens playing.")
]
Web = Annotated[bool, typer.Option("--web", help="Show the scenes in a browser.")]
Port = Annotated[
    int,
    typer.Option(help="Port of the page, with --web; 0 takes one that is free.", min=0, max=65535),
]
PrintJsonOption = Annotated[
    bool,
    typer.Option(
        "--json", help="Print events as JSON, one a line: opened, picture, served, closed."
    ),
]
Pictures = Annotated[Path, typer.Option(help="Folder of saved pictures.")]


@with_streaming_options
def view(
    scenes: options.Scenes,
    *,
    camera: options.RenderCamera = None,
    width: WindowWidth = None,
    height: WindowHeight = None,
    fov: options.FieldOfView = None,
    up: options.Axis = None,
    orthographic: options.Orthographic = False,
    panorama: options.Panorama = False,
    mode: options.ModeOption = "color",
    background: Background = None,
    time: Time = None,
    origin: options.Origin = "auto",
    pose: options.Poses = None,
    inputs: options.Inputs = None,
    image: options.Images = None,
    image_cameras: options.ImageCameras = None,
    frames: Frames = None,
    fps: FramesPerSecond = None,
    play: PlayOption = True,
    sh_degree: options.ShDegree = None,
    antialias: options.Antialias = None,
    rasteriser: options.RasteriserName = "auto",
    compact: options.Compact = False,
    post: options.Post = None,
    size: options.ImageSizes = None,
    provider: options.Provider = "cpu",
    pictures: Pictures = Path(),
    trust: options.TrustOption = False,
    timeout: options.ModelTimeout = None,
    memory: options.ModelMemory = None,
    web: Web = False,
    ort: options.OrtFolder = None,
    three: options.ThreeFolder = None,
    port: Port = 0,
    as_json: PrintJsonOption = False,
    streaming: StreamSettings = StreamSettings(),  # noqa: B008
) -> None:
    """Show SCENES in a window: orbit around them, play their time, and save pictures.

    The key H lists all keys; files can be dropped on the window. --web shows a page instead.

    Exits 0 once the window is closed, 2 for wrong options or no screen, 4 for unreadable scenes.
    """
    from gsgen.cli.commands.drawing.opening import open_scenes, read_splats, training_camera
    from gsgen.formats.shared.origins import parse_origin
    from gsgen.runtime.playback.live_playback import LivePlayback
    from gsgen.runtime.playback.scene_camera import scene_viewpoint
    from gsgen.runtime.viewer import surface_renderer, viewer

    if web:
        page = _page_view(background, fov, up, time, play=play)
        read = partial(read_splats, origin=parse_origin(origin))
        return _serve_page(
            scenes, page, read, ort, three, port, image, image_cameras, as_json=as_json
        )
    symbols, width, height = options.split_image_size(size, width, height, scenes)
    _require_display(scenes)
    files, color = _files_and_background(scenes, background)
    if camera is None and not (files or orthographic or panorama):
        camera = training_camera(scenes)
    viewpoint = scene_viewpoint(
        files, camera, width, height, fov, up, orthographic=orthographic, panorama=panorama
    )
    _print_notes(viewpoint.notes)
    if viewpoint.times:
        _print_notes(["not used: the times of the cameras; the window plays the time"])
    if viewpoint.keys is not None:
        _print_notes(["not used: the key frames of the camera; --web plays them"])
    limits = options.model_limits(timeout, memory, trust=trust)
    with open_scenes(
        scenes,
        post,
        provider=provider,
        size=symbols,
        origin=parse_origin(origin),
        streaming=replace(streaming, wait=0),
        limits=limits,
    ) as (sources, models):
        tracks, pose_fps = options.read_tracks(
            pose, inputs, sources, fps, images=image, image_cameras=image_cameras
        )
        playback = LivePlayback(
            sources,
            post=models,
            tracks=tracks,
            time=time,
            frames=frames,
            fps=fps or pose_fps,
            sh_degree=sh_degree,
            antialias=antialias,
        )
        playback.playing = play and playback.frames > 1
        interface = viewer.Viewer(
            playback,
            viewpoint,
            renderer=surface_renderer.SurfaceRenderer(rasteriser=rasteriser, compact=compact),
            mode=options.mode_of(mode),
            background=color,
            folder=pictures,
            print_line=echo,
            on_event=_print_event if as_json else None,
            open_files=_file_opener(limits, play=play),
        )
        _open_window(interface, scenes, viewpoint.camera(sources[0], 0, 0.0), as_json=as_json)


def _print_event(event: Mapping[str, Any]) -> None:
    echo_json(event, indent=None)


def _print_notes(notes: Sequence[str]) -> None:
    for note in notes:
        echo(f"note: {note}", err=True)


def _open_window(
    interface: "Viewer", scenes: Sequence[Path], home_camera: "Camera", *, as_json: bool
) -> None:
    """Show a viewer in a window of its first camera's size, until it is closed."""
    from gsgen.cli.progress import clear, progress
    from gsgen.runtime.viewer import window

    if as_json:
        _print_event({"event": "opened", "scenes": list(map(str, scenes))})
    try:
        progress("uploading the scene and compiling shaders")
        window.open_window(
            interface,
            _window_title(scenes),
            (home_camera.width, home_camera.height),
            after_draw=clear,
        )
    finally:
        interface.playback.close()
    if as_json:
        _print_event({"event": "closed"})


def _page_view(
    background: str | None, fov: float | None, up: str | None, time: float | None, *, play: bool
) -> "ModelView":
    """Return the display settings of a web page of models, from the options of `gsgen view`."""
    from gsgen.runtime.scene.colors import color_of
    from gsgen.runtime.web.pages import ModelView

    color = None if background is None else color_of(background, "--background")[:3]
    return ModelView(background=color, fov=fov, up=up, time=time, play=play)


def _serve_page(
    scenes: Sequence[Path],
    model_view: "ModelView",
    read: "SplatReader",
    ort: Path | None,
    three: Path | None,
    port: int,
    images: Sequence[str] | None,
    image_cameras: str | None,
    *,
    as_json: bool,
) -> None:
    """Serve a web page of the scenes until Ctrl-C, and open the page in the browser."""
    import webbrowser

    from gsgen.contract.process.atomic_files import MODEL_SUFFIX
    from gsgen.runtime.playback.picture_inputs import camera_list, picture_files
    from gsgen.runtime.web.onnxruntime_web import ort_folder
    from gsgen.runtime.web.pages import files_shown
    from gsgen.runtime.web.serving import ModelServer
    from gsgen.runtime.web.three_js import THREE

    for path in scenes:
        if path.suffix.lower() in (".html", ".htm"):
            raise ConfigInvalid(
                "is a page, expected a scene",
                where=str(path),
                hint=f"--web serves a page; `gsgen export html SCENE -o {path.name}` writes one.",
            )
    files = files_shown(scenes)
    for file in files:
        file.content(read)  # an unreadable file is an error here, not in the page alone
    has_generator = any(file.path.suffix.lower() == MODEL_SUFFIX for file in files)
    folder = ort_folder(ort) if has_generator else None
    has_three = three is not None or any(file.is_mesh for file in files)
    three_folder = THREE.located(three) if has_three else None
    pictures = picture_files(images) if images else []
    cameras = camera_list(image_cameras, pictures) if image_cameras else ""
    try:
        server = ModelServer(
            scenes,
            model_view,
            ort=folder,
            three=three_folder,
            port=port,
            read=read,
            images=pictures,
            image_cameras=cameras,
        )
    except OSError as error:
        hint = "Choose another --port; 0 takes one that is free."
        message = f"cannot listen: {error.strerror}"
        raise ConfigInvalid(message, where=f"127.0.0.1:{port}", hint=hint) from error
    with server:
        if as_json:
            _print_event({"event": "served", "address": server.address})
        else:
            echo(server.address)
        echo("the page is served until Ctrl-C", err=True)
        webbrowser.open(server.address)
        server.serve_forever(poll_interval=0.1)


def _files_and_background(
    scenes: Sequence[Path], text: str | None
) -> "tuple[list[SceneFile], tuple[float, float, float, float]]":
    """Return the scene files and the background: --background, or else the first file's own."""
    from gsgen.cli.commands.drawing.opening import read_scene_files
    from gsgen.runtime.playback.scene_camera import first_setting
    from gsgen.runtime.scene.colors import color_of

    files = list(read_scene_files(scenes).values())
    option_color = None if text is None else color_of(text, "--background")
    color = first_setting([option_color, *(file.background for file in files)])
    return files, color or (0.0, 0.0, 0.0, 1.0)


def _require_display(scenes: Sequence[Path]) -> None:
    """Raise if no window can be opened, and suggest a command that draws without one."""
    from gsgen.runtime.errors import DisplayUnavailable
    from gsgen.runtime.viewer import window

    try:
        window.require_display()
    except DisplayUnavailable as error:
        command = shlex.join(["gsgen", "render", *map(str, scenes), "-o", "view.png"])
        hint = error.hint or f"Without a screen: {command}"
        raise DisplayUnavailable(error.message, hint=hint) from error


def _window_title(scenes: Sequence[Path]) -> str:
    return ", ".join(path.name for path in scenes) + " - gsgen"


def _file_opener(
    limits: "Limits | None", *, play: bool
) -> "Callable[[Sequence[Path]], LivePlayback]":
    """Return a function that opens dropped files for live playback."""
    from gsgen.cli.commands.drawing.opening import confined_models, tileset_opener
    from gsgen.runtime.playback.live_playback import LivePlayback
    from gsgen.runtime.sources.scene_source import sources_of

    def open_files(paths: Sequence[Path]) -> LivePlayback:
        confined = confined_models(paths, (), limits)
        stream = tileset_opener(StreamSettings(wait=0), confined)
        playback = LivePlayback(sources_of(list(paths), stream, confined))
        playback.playing = play and playback.frames > 1
        return playback

    return open_files

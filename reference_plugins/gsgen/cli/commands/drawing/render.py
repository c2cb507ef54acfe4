"""`gsgen render`: draws splat files and ONNX generators into pictures and videos."""

__all__ = ["render"]

import time as clock
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import typer

from gsgen.cli.commands.drawing import options
from gsgen.cli.commands.drawing.streaming_options import with_streaming_options
from gsgen.cli.output import echo, echo_json
from gsgen.cli.output_hints import require_own_output
from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.runtime.sources.stream_settings import StreamSettings

if TYPE_CHECKING:
    from gsgen.runtime.media.mp4 import Sound
    from gsgen.runtime.media.pictures import Mode
    from gsgen.runtime.playback.frame_sequence import FrameSequence
    from gsgen.runtime.sources.scene_file import SceneFile
    from gsgen.runtime.sources.source import Source

Output = Annotated[
    Path,
    typer.Option(
        "-o",
        "--output",
        help="A picture, an .exr or .npy of floats, an .mp4 (AV1), a .gif, or a folder of frames.",
        show_default=False,
    ),
]
Background = Annotated[
    str | None,
    typer.Option(
        help="black, white, transparent, #rrggbb or R,G,B[,A] from 0 to 1. "
        "[default: black; transparent for .npy]"
    ),
]
Time = Annotated[float | None, options.time_option("Time of generators. [default: the manifest's]")]
Frames = Annotated[
    int | None,
    typer.Option(
        help="Number of frames. Time, or else a frame number, goes through its range; if nothing "
        "moves, an orbit turns. [default: one per camera, pose or value]",
        min=1,
    ),
]
TurnOption = Annotated[
    float | None,
    typer.Option(help="Degrees that an orbit turns over all frames. [default: 360 or 0]"),
]
FramesPerSecond = Annotated[
    float | None,
    typer.Option(
        help="Frames per second of a video. [default: the manifest's, or 25]", min=0.1, max=100
    ),
]
BitsOption = Annotated[
    Literal["8", "16"], typer.Option(help="Bits of each channel of PNG files; an .exr has 32.")
]
WaitOption = Annotated[
    float, typer.Option(help="Most seconds that a frame waits for tiles of a tileset.", min=0.1)
]
AllowMissing = Annotated[
    bool, typer.Option("--allow-missing", help="Exit 0 although tiles of a tileset are missing.")
]
Stereo = Annotated[
    bool,
    typer.Option(
        "--stereo",
        help="Draw a left and a right eye, which look the same way, side by side; --size is that of "
        "one eye.",
    ),
]
_EYE_DISTANCE: Final = 0.063  # metres: the mean of grown people (Dodgson 2004)
EyeDistance = Annotated[
    float | None,
    typer.Option(
        help="Metres between the eyes of --stereo; models tell the length of their unit, other "
        "scenes are taken to be in metres.",
        min=1e-6,
        show_default=str(_EYE_DISTANCE),
    ),
]
WeightedSums = Annotated[
    Literal["contract", "published"],
    typer.Option(
        help="Background of weighted sums: by the contract, or by the renderer that was published "
        "with the method."
    ),
]


@with_streaming_options
def render(
    scenes: options.Scenes,
    output: Output,
    *,
    camera: options.RenderCamera = None,
    width: options.Width = None,
    height: options.Height = None,
    fov: options.FieldOfView = None,
    up: options.Axis = None,
    orthographic: options.Orthographic = False,
    panorama: options.Panorama = False,
    stereo: Stereo = False,
    eye_distance: EyeDistance = None,
    mode: options.ModeOption = "color",
    background: Background = None,
    time: Time = None,
    origin: options.Origin = "auto",
    pose: options.Poses = None,
    inputs: options.Inputs = None,
    image: options.Images = None,
    image_cameras: options.ImageCameras = None,
    frames: Frames = None,
    turn: TurnOption = None,
    fps: FramesPerSecond = None,
    sh_degree: options.ShDegree = None,
    antialias: options.Antialias = None,
    rasteriser: options.RasteriserName = "auto",
    compact: options.Compact = False,
    wsr: WeightedSums = "contract",
    post: options.Post = None,
    size: options.ImageSizes = None,
    bits: BitsOption = "8",
    provider: options.Provider = "cpu",
    wait: WaitOption = 30.0,
    allow_missing: AllowMissing = False,
    trust: options.TrustOption = False,
    timeout: options.ModelTimeout = None,
    memory: options.ModelMemory = None,
    as_json: options.PrintJsonOption = False,
    streaming: StreamSettings = StreamSettings(),  # noqa: B008
) -> None:
    """Draw SCENES: splat files and meshes, and generators, which run for every frame.

    A scene.json gives each file its place, and a camera; options take precedence over it.

    Exits 0 if everything was written, 2 for wrong options, 4 if a scene cannot be read, also after
    it wrote a picture that lacks tiles.
    """
    from gsgen.cli.commands.drawing.input_files import input_files, refuse_inputs, scene_inputs
    from gsgen.cli.commands.drawing.opening import open_scenes, read_scene_files, training_camera
    from gsgen.formats.shared.origins import parse_origin
    from gsgen.runtime.media.deep_pictures import EXR_SUFFIX
    from gsgen.runtime.media.output_formats import require_output_format
    from gsgen.runtime.media.pictures import IMAGE_SUFFIXES
    from gsgen.runtime.playback.frame_sequence import FrameSequence
    from gsgen.runtime.playback.scene_camera import scene_viewpoint
    from gsgen.runtime.renderer.renderer import Renderer

    if eye_distance is not None and not stereo:
        raise ConfigInvalid("is that of two eyes: add --stereo", where="--eye-distance")
    symbols, width, height = options.split_image_size(size, width, height, [*scenes, *(post or ())])
    bit_count: Literal[8, 16] = 16 if bits == "16" else 8
    read_files = input_files(
        scenes,
        camera=camera,
        poses=pose,
        inputs=inputs,
        post=post,
        images=image,
        image_cameras=image_cameras,
    )
    refuse_inputs(output, read_files)
    require_own_output("render", output, scenes)
    require_output_format(output, frames=frames or 1, bits=bit_count)
    files = list(read_scene_files(scenes).values())
    refuse_inputs(output, scene_inputs(files))
    if camera is None and not (files or orthographic or panorama):
        camera = training_camera(scenes)
    view = scene_viewpoint(
        files, camera, width, height, fov, up, orthographic=orthographic, panorama=panorama
    )
    color = _background(background, output, files)
    with open_scenes(
        scenes,
        post,
        provider=provider,
        size=symbols,
        origin=parse_origin(origin),
        streaming=replace(streaming, wait=wait),
        limits=options.model_limits(timeout, memory, trust=trust),
        scene_posts=options.mode_of(mode) == "color",
    ) as (sources, models):
        tracks, pose_fps = options.read_tracks(
            pose, inputs, sources, fps, images=image, image_cameras=image_cameras
        )
        is_published = wsr == "published"
        if is_published:
            _require_weighted_sums(sources)
        is_still = output.suffix.lower() in (*IMAGE_SUFFIXES, EXR_SUFFIX)
        if view.span is not None and is_still and not view.cameras:
            frames = frames or 1  # a picture of a timeline is that of its start
        sequence = FrameSequence(
            sources,
            view,
            options.mode_of(mode),
            background=color,
            sh_degree=sh_degree,
            antialias=antialias,
            time=time,
            frames=frames,
            turn=turn,
            fps=fps or pose_fps,
            tracks=tracks,
            post=models,
            eye_distance=eye_distance or _EYE_DISTANCE if stereo else None,
            renderer=Renderer(rasteriser=rasteriser, compact=compact, published=is_published),
        )
        for note in (*sequence.notes, *_transparency_notes(output, color, options.mode_of(mode))):
            echo(f"note: {note}", err=True)
        sound = _sound(sequence, files, output)
        _write(sequence, sources, output, bits=bit_count, as_json=as_json, sound=sound)
        _report_shortfalls(sources, allow_missing=allow_missing)


def _sound(sequence: "FrameSequence", files: "list[SceneFile]", output: Path) -> "Sound | None":
    """Return the sound of the first scene file with one; a note says why a film is silent."""
    from gsgen.runtime.playback.sound_tracks import SOUND_SUFFIX, film_sound

    file = next((file for file in files if file.sound), None)
    if file is None or file.sound is None or output.suffix.lower() != ".mp4":
        return None
    if file.sound.path.suffix.lower() != SOUND_SUFFIX:
        echo(f"note: the film is silent: {file.sound.path} is no {SOUND_SUFFIX} file", err=True)
        return None
    seconds, frame = sequence.frames / sequence.fps, 1 / sequence.fps
    length = file.span.seconds if file.span else 0.0
    if abs(seconds - length) > 1.5 * frame:
        echo(f"note: the film is silent: it lasts {seconds:g} s, the timeline {length:g}", err=True)
        return None
    return film_sound(file.sound, seconds)


def _report_shortfalls(sources: "list[Source]", *, allow_missing: bool) -> None:
    """Raise if the pictures, which were written, lack tiles; note it if that is allowed."""
    for shortfall in filter(None, (source.shortfall for source in sources)):
        tiles = "1 tile is" if shortfall.tiles == 1 else f"{shortfall.tiles:,} tiles are"
        count = f"{tiles} missing, or drawn coarser: " if shortfall.tiles else ""
        text = f"{count}{shortfall.cause}"
        if not allow_missing:
            raise InputUnreadable(
                text, where=shortfall.name, hint="--allow-missing accepts such pictures."
            )
        echo(f"note: {shortfall.name}: {text}", err=True)


def _require_weighted_sums(sources: "list[Source]") -> None:
    """Raise if a scene's splats are not blended by weighted sums, as ``--wsr published`` needs."""
    unsummed_set = next(
        (source for source in sources if source.weighted is None or source.meshes), None
    )
    if unsummed_set is not None:
        raise ConfigInvalid(
            f"{unsummed_set.name} is not blended by weighted sums, which this option needs",
            where="--wsr published",
            hint="Leave that scene out, or draw with `--wsr contract`.",
        )


def _background(
    text: str | None, output: Path, files: "list[SceneFile]"
) -> tuple[float, float, float, float]:
    from gsgen.runtime.playback.scene_camera import first_setting
    from gsgen.runtime.scene.colors import color_of

    scene_background = first_setting([file.background for file in files])
    if text is None and scene_background is not None:
        return scene_background
    if text is None:
        text = "transparent" if output.suffix.lower() == ".npy" else "black"
    return color_of(text, "--background")


def _transparency_notes(
    output: Path, background: tuple[float, float, float, float], mode: "Mode"
) -> list[str]:
    """Return notes on formats that cannot store a transparent background."""
    from gsgen.runtime.media.pictures import OPAQUE_SUFFIXES

    suffix = output.suffix.lower()
    if background[3] == 1 or mode != "color":
        return []
    if suffix in OPAQUE_SUFFIXES:
        return [f"{suffix} has no transparency: the background is blended with black"]
    if suffix == ".gif":
        return [
            "pixels of a .gif are opaque or absent: those covered by half or more are opaque; "
            "a folder of pictures keeps the alpha"
        ]
    return []


def _write(
    sequence: "FrameSequence",
    sources: "list[Source]",
    output: Path,
    *,
    bits: Literal[8, 16],
    as_json: bool,
    sound: "Sound | None",
) -> None:
    """Draw all frames of a sequence into ``output``, and print a summary."""
    from gsgen.cli.progress import clear, progress
    from gsgen.runtime.media.pictures import VIDEO_SUFFIXES

    if sequence.frames == 1 and not (output.suffix or output.is_dir()):
        raise ConfigInvalid(
            "has no suffix, expected that of a picture",
            where=str(output),
            hint=f"Name {output}.png; several frames go into a folder.",
        )
    if sequence.frames == 1 and output.suffix.lower() in VIDEO_SUFFIXES:
        echo(f"note: one frame; --frames 100 {sequence.motion}", err=True)
    start_time = clock.perf_counter()
    sequence.write(
        output,
        lambda number: progress(f"frame {number} of {sequence.frames}"),
        bits=bits,
        sound=sound,
    )
    clear()
    seconds = clock.perf_counter() - start_time
    document = sequence.summary() | {"output": str(output), "seconds": round(seconds, 3)}
    if as_json:
        shortfalls = [shortfall for source in sources if (shortfall := source.shortfall)]
        echo_json(document | {"missing": sum(shortfall.tiles for shortfall in shortfalls)})
        return
    count = f"{sequence.frames} frames of " if sequence.frames > 1 else ""
    triangles = f"{document['triangles']:,} triangles, " if document["triangles"] else ""
    echo(
        f"{output}: {count}{document['width']}×{document['height']}, "
        f"{document['visible']:,} of {document['gaussians']:,} Gaussians drawn, {triangles}"
        f"{seconds:.2f} s on {document['device']}"
    )
    if document["gaussians"] and not document["visible"]:
        echo("note: no Gaussian is visible: all are behind the camera or transparent", err=True)
    elif not document["gaussians"] and not document["triangles"]:
        time_text = "with these inputs" if sequence.frames == 1 else "in the last frame"
        echo(f"note: there are no Gaussians {time_text}: --time and --input set others", err=True)

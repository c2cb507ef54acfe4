"""`gsgen bake`: writes frames of an ONNX generator as plain splat files."""

__all__ = ["bake"]

import math
from contextlib import closing, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.commands.drawing.options import (
    Axis,
    ImageCameras,
    Images,
    ModelMemory,
    ModelTimeout,
    Provider,
    Sizes,
    TrustOption,
    model_limits,
    read_tracks,
)
from gsgen.cli.output import echo, echo_error, echo_json
from gsgen.cli.output_hints import require_own_output
from gsgen.contract.errors import ConfigInvalid, ExitCode
from gsgen.formats.codecs import writable_formats

if TYPE_CHECKING:
    from gsgen.runtime.baking.report import BakeReport
    from gsgen.runtime.playback.camera_options import Viewpoint
    from gsgen.runtime.playback.input_tracks import Track
    from gsgen.runtime.scene.camera import Camera
    from gsgen.runtime.sources.source import GeneratorSource


_Output = Annotated[
    Path,
    typer.Option(
        "-o",
        "--output",
        help="The splat file to write; for several frames a pattern such as seq/%04d.ply.",
        show_default=False,
    ),
]
_Time = Annotated[
    str | None,
    typer.Option(
        metavar="TIME|FIRST:LAST:COUNT",
        help="A time, or a range with both ends. [default: the manifest's]",
    ),
]
_Poses = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[NAME=]FILE",
        help="A pose or one pose per frame, in any format of `gsgen render`; repeatable.",
    ),
]
_InputValues = Annotated[
    list[str] | None,
    typer.Option(
        "--input",
        metavar="NAME=VALUE",
        help="Another input, by its name or role: a number, A,B,…, FIRST:LAST:COUNT, or a "
        "file; repeatable.",
    ),
]
_BakedCamera = Annotated[
    str | None,
    typer.Option(
        help="Bake what this camera sees; see `gsgen render`. [default: colours are fitted for all]"
    ),
]
_Psnr = Annotated[
    bool | None,
    typer.Option(
        "--psnr/--no-psnr",
        help="Render the files and the model and print the PSNR. "
        "[default: if something depends on the camera]",
        show_default=False,
    ),
]


def bake(
    model: Annotated[Path, typer.Argument(help="The ONNX generator.", show_default=False)],
    output: _Output,
    time: _Time = None,
    pose: _Poses = None,
    inputs: _InputValues = None,
    image: Images = None,
    image_cameras: ImageCameras = None,
    camera: _BakedCamera = None,
    up: Axis = None,
    views: Annotated[
        int, typer.Option(help="Cameras around the scene that colours are fitted to.", min=20)
    ] = 30,
    sh_degree: Annotated[
        int, typer.Option(help="Highest SH degree of fitted colours.", min=0, max=3)
    ] = 3,
    psnr: _Psnr = None,
    format: Annotated[
        str | None, typer.Option(help=f"{writable_formats()}. [default: by the suffix of OUTPUT]")
    ] = None,
    size: Sizes = None,
    provider: Provider = "cpu",
    trust: TrustOption = False,
    timeout: ModelTimeout = None,
    memory: ModelMemory = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Write frames of a generator as plain splat files, which every viewer reads.

    Only drawn rows are written (live, opacity at least 1/255), in their order. Colours that depend
    on the view are fitted with spherical harmonics, and the PSNR is printed.

    Exits 0 if everything was written, 1 if the format cannot store a value, 2 for invalid options
    or if a file cannot be written, 4 if the model cannot be read.
    """
    from gsgen.cli.commands.drawing.input_files import input_files
    from gsgen.cli.commands.drawing.opening import confined_models
    from gsgen.cli.model_options import sizes_of
    from gsgen.cli.progress import clear, progress
    from gsgen.formats import FileUnwritable, FormatError
    from gsgen.runtime.baking.bake_frames import bake_source
    from gsgen.runtime.playback.input_tracks import require_pictures
    from gsgen.runtime.sources.source import GeneratorSource

    if format is None:
        require_own_output("bake", output, [model])
    tracks, view = _tracks(time, inputs), _viewpoint(camera, up)
    limits = model_limits(timeout, memory, trust=trust)
    with (
        confined_models((), [model], limits, provider) or nullcontext() as confined,
        closing(GeneratorSource(model, provider, sizes_of(size), confined)) as source,
    ):
        file_tracks, _ = read_tracks(
            pose, None, [source], images=image, image_cameras=image_cameras
        )
        tracks += file_tracks
        require_pictures([source], tracks)
        try:
            report = bake_source(
                source,
                output,
                tracks=_with_camera_times(tracks, view, source),
                cameras=_cameras(view, source),
                format=format,
                views=views,
                max_degree=sh_degree,
                psnr=psnr,
                progress=progress,
                inputs=input_files(
                    [model],
                    camera=camera,
                    poses=pose,
                    inputs=inputs,
                    images=image,
                    image_cameras=image_cameras,
                ),
            )
        except FileUnwritable:
            raise
        except FormatError as error:
            echo_error(error)
            raise typer.Exit(ExitCode.FAILURE) from error
        finally:
            clear()
    for note in report.notes:
        echo(f"note: {note}", err=True)
    echo_json(_report_as_dict(report)) if as_json else echo(*_report_lines(report))


def _tracks(time: str | None, inputs: list[str] | None) -> "list[Track]":
    """Parse ``--time`` and ``--input`` into the values of model inputs in each frame."""
    from gsgen.runtime.baking.frame_values import number_range
    from gsgen.runtime.playback.input_tracks import Track, input_track

    tracks = []
    if time is not None:
        tracks.append(Track("time", number_range(time, "--time"), "--time"))
    for text in inputs or ():
        word, _, value = text.partition("=")
        if word and value.count(":") == 2 and not Path(value).exists():
            where = f"--input {word}"
            tracks.append(Track(word, number_range(value, where), where))
            continue
        track = input_track(text)
        if track.sweep:
            raise ConfigInvalid(
                f"{text!r} does not say how many frames to bake",
                where=track.where,
                hint="Write FIRST:LAST:COUNT, for example 0:1:30.",
            )
        tracks.append(track)
    return tracks


def _viewpoint(text: str | None, up: str | None) -> "Viewpoint | None":
    """Return the cameras of ``--camera``; None without the option."""
    if text is None:
        return None
    from gsgen.runtime.playback.camera_options import viewpoint

    return viewpoint(text, up=up)


def _with_camera_times(
    tracks: "list[Track]", view: "Viewpoint | None", source: "GeneratorSource"
) -> "list[Track]":
    """Add the times of a camera file to the tracks, and print the notes on the cameras."""
    if view is None:
        return tracks
    from gsgen.runtime.playback.timeline import camera_time_tracks

    camera_tracks, notes = camera_time_tracks(view, [source], tracks)
    for note in (*view.notes, *notes):
        echo(f"note: {note}", err=True)
    return [*camera_tracks, *tracks]


def _cameras(view: "Viewpoint | None", source: "GeneratorSource") -> "list[Camera]":
    """Return one camera per frame, or none if colours are fitted for all."""
    if view is None:
        return []
    return [view.camera(source, number, 0.0) for number in range(max(1, len(view.cameras)))]


def _report_as_dict(report: "BakeReport") -> dict[str, object]:
    """Convert a bake's report to JSON types: an infinite PSNR becomes the text ``inf``."""
    document = asdict(report)
    for frame in document["frames"]:
        if frame["psnr"] is not None and math.isinf(frame["psnr"]):
            frame["psnr"] = "inf"
    return document


def _report_lines(report: "BakeReport") -> list[str]:
    first_frame, last_frame = report.frames[0], report.frames[-1]
    count = sum(frame.count for frame in report.frames)
    size = sum(frame.bytes for frame in report.frames) / (1 << 20)
    name = (
        first_frame.file if len(report.frames) == 1 else f"{first_frame.file} … {last_frame.file}"
    )
    frames = f"{len(report.frames)} frames, " if len(report.frames) > 1 else ""
    lines = [
        f"{name}: {frames}{count:,} splats of SH degree {first_frame.sh_degree}, {report.format}, "
        f"{size:.2f} MiB in {report.seconds:.1f} s"
    ]
    if report.fit_error:
        errors = ", ".join(
            f"{error:.4f} (degree {degree})" for degree, error in enumerate(report.fit_error)
        )
        lines.append(f"error of colours at held-out cameras: {errors}")
    measured = [frame.psnr for frame in report.frames if frame.psnr is not None]
    if measured:
        camera_word = "cameras" if report.test_cameras > 1 else "camera"
        lowest_text = f", lowest of {len(measured)} frames" if len(measured) > 1 else ""
        lines.append(
            f"PSNR against the model at {report.test_cameras} {camera_word}: "
            f"{min(measured):.1f} dB{lowest_text}"
        )
    return lines

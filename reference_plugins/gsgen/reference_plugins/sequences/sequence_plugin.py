"""The command `gsgen export sequence`: exports frames of splats as one small ONNX generator."""

__all__ = ["PLUGIN", "build"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import typer

from gsgen.reference_plugins.loading.options import Fps, Loop, note
from gsgen.sdk.plugins.plugin import Demo, Plugin

if TYPE_CHECKING:
    from gsgen.reference_plugins.sequences.segmented_clip import ClipExport

_USUAL_QUALITY: Final = 75
_QUALITY_STEPS: Final = 12  # so many steps halve the error


def build(
    frames: Annotated[
        list[Path],
        typer.Argument(
            help="A folder of numbered splat files, a pattern such as frames/%04d.ply, or the "
            "files in order.",
            show_default=False,
        ),
    ],
    fps: Fps = None,
    *,
    loop: Loop = False,
    quality: Annotated[
        int,
        typer.Option(
            help="From 1 to 100; 12 more halve the error, 75 is an error of 0.08.", min=1, max=100
        ),
    ] = _USUAL_QUALITY,
    error: Annotated[
        float | None,
        typer.Option(
            help="Largest mean error of centres, in radii of each Gaussian; other errors follow.",
            show_default="by --quality",
            min=0.001,
            max=10,
        ),
    ] = None,
    max_bytes: Annotated[
        int | None, typer.Option(help="Let errors grow until the tables have so many bytes.", min=1)
    ] = None,
    moments: Annotated[
        int,
        typer.Option(
            help="Draw so many moments of the model and of the frames, and print PSNR and SSIM.",
            min=0,
        ),
    ] = 4,
    segment: Annotated[
        float | None,
        typer.Option(
            help="Seconds of a segment, where the output is a scene file.",
            show_default="2",
            min=0.01,
        ),
    ] = None,
    up: Annotated[
        Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None,
        typer.Option(help="Axis of the frames that points up.", show_default="the files', or -y"),
    ] = None,
    sound: Annotated[
        Path | None,
        typer.Option(
            help="Recording that plays with a scene file, from its start.", show_default=False
        ),
    ] = None,
    captions: Annotated[
        Path | None, typer.Option(help="WebVTT captions of --sound.", show_default=False)
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(
            help="What exports segments: serial, processes, dask (this machine) or dask=ADDRESS.",
            show_default="serial",
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes. [default: one a processor core]", min=1, max=1024)
    ] = None,
) -> "ClipExport":
    """Read frames of splats for their export as an ONNX generator with the input time.

    With `-o clip.json`, a scene file is written, and a folder of segments that follow each other.
    """
    from gsgen.contract.errors import ConfigInvalid
    from gsgen.reference_plugins.sequences.frame_files import FrameFiles
    from gsgen.reference_plugins.sequences.segmented_clip import ClipExport
    from gsgen.sdk.sequences.clip_source import ClipSource
    from gsgen.sdk.sequences.encoding import USUAL_ERROR, ErrorBudget

    if error is not None and quality != _USUAL_QUALITY:
        message, hint = "is given beside --error", "Give one of the two."
        raise ConfigInvalid(message, where="--quality", hint=hint)
    factor = 2.0 ** ((_USUAL_QUALITY - quality) / _QUALITY_STEPS)
    files = FrameFiles.of(frames, up)
    note(f"{len(files.paths):,} frames, {files.paths[0]} to {files.paths[-1]}")
    clip = ClipSource(
        names=[str(path) for path in files.paths],
        read=files.read,
        fps=fps,
        loop=loop,
        budget=ErrorBudget().scaled(factor if error is None else error / USUAL_ERROR),
        max_bytes=max_bytes,
    )
    return ClipExport(
        files=files,
        clip=clip,
        moments=moments,
        seconds=segment,
        sound=sound,
        captions=captions,
        engine=engine,
        workers=workers,
    )


def _write_demo(folder: Path) -> list[str]:
    from gsgen.reference_plugins.sequences.synthetic_sequence import write_sequence

    write_sequence(folder / "frames", rows=12_000, frames=24)
    return [str(folder / "frames")]


PLUGIN = Plugin(
    name="sequence",
    words="frames animation ply-sequence flipbook video",
    summary="A sequence of splat files, as one small model that plays.",
    reads="Reads a folder of numbered splat files, a pattern, or a list of files. Row i of each "
    "file is the same Gaussian.",
    inputs=("time",),
    demo=Demo(write=_write_demo, caption="time 0 to 1", view="still"),
    build=build,
)

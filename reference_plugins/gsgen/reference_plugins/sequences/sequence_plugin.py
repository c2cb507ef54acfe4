"""The command `gsgen export sequence`: exports frames of splats as one small ONNX generator."""

__all__ = ["PLUGIN", "build"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.reference_plugins.loading.options import Fps, Loop, note
from gsgen.sdk.plugins.plugin import Demo, Plugin

if TYPE_CHECKING:
    from gsgen.sdk.sequences.clip_source import ClipSource


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
) -> "ClipSource":
    """Read frames of splats for their export as an ONNX generator with the input time."""
    from gsgen.reference_plugins.sequences.frame_files import FrameFiles
    from gsgen.sdk.sequences.clip_source import ClipSource

    files = FrameFiles.of(frames)
    note(f"{len(files.paths):,} frames, {files.paths[0]} to {files.paths[-1]}")
    return ClipSource(
        names=[str(path) for path in files.paths], read=files.read, fps=fps, loop=loop
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

"""The report of a bake: files, numbers of Gaussians, SH degree and measured PSNR."""

__all__ = ["BakeReport", "BakedFrame"]

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BakedFrame:
    """One written splat file of a bake.

    Attributes:
        file: Path of the file.
        count: Number of Gaussians in the file.
        skipped: Number of live rows that were skipped: not finite, or opacity below 1/255.
        sh_degree: SH degree of the colours.
        bytes: Size of the file.
        time: Value of the time input; None without such an input.
        psnr: In dB over all test cameras, against the generator's own renders; None if it was not
            measured, infinity if all pixels are equal.
    """

    file: str
    count: int
    skipped: int
    sh_degree: int
    bytes: int
    time: float | None = None
    psnr: float | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BakeReport:
    """The result of baking frames of an ONNX generator to splat files.

    Attributes:
        model: The generator.
        format: Name of the format that was written.
        frames: The files, in the order of the frames.
        view_dependence: Outputs that change with the camera and were averaged or fitted:
            ``none``, ``colors``, ``rows`` or ``rows and colors``; ``camera`` if one was given.
        fit_error: Root mean square error of colours at held-out cameras, by SH degree, in the
            first frame; empty if nothing was fitted.
        test_cameras: Cameras that PSNR was measured at.
        notes: Sentences about what the files do not hold.
        seconds: Duration.
    """

    model: str
    format: str
    frames: tuple[BakedFrame, ...]
    view_dependence: str
    fit_error: tuple[float, ...]
    test_cameras: int
    notes: tuple[str, ...]
    seconds: float

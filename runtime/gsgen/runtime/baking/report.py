"""The report of a bake: files, rows, SH degree and measured PSNR."""

__all__ = ["BakeReport", "BakedFrame"]

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BakedFrame:
    """One written file.

    Attributes:
        file: Its path.
        count: Gaussians in it.
        skipped: Live rows that are not in it: their opacity is below 1/255, or not finite.
        sh_degree: SH degree of its colours.
        bytes: Its size.
        time: Value of the time input; None if the model has none.
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
    """A finished bake.

    Attributes:
        model: The generator.
        format: Name of the format that was written.
        frames: The files, in the order of the frames.
        view_dependence: Outputs that change with the camera and were averaged or fitted:
            ``none``, ``colors``, ``rows`` or ``rows and colors``; ``camera`` if one was given.
        fit_error: Root mean square error of colours at held-out cameras, by SH degree, in the
            first frame; empty if nothing was fitted.
        test_cameras: Cameras that PSNR was measured at.
        notes: What the files do not hold, as sentences.
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

"""Summarises quantities of splats, such as opacity, as numbers, a table or histograms."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.formats.editing.filters import FILTER_QUANTITIES
from gsgen.formats.shared.errors import NotSupported
from gsgen.formats.shared.files import FilePath, replace_file
from gsgen.formats.shared.splats import Splats

_LOG_SCALED_WORD: Final = "scale"  # quantities with this word are drawn on a logarithmic axis
_BIN_COUNT, _BAR_WIDTH, _PLOT_HEIGHT, _COLUMN_COUNT, _MARGIN_PIXELS = 80, 3, 90, 3, 18


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """The distribution of one quantity, such as opacity, over the splats where it is finite.

    Attributes:
        name: The quantity, a key of ``FILTER_QUANTITIES``.
        count: The splats with a finite value.
        low: The least value.
        median: The value in the middle.
        high: The largest value.
        mean: The mean.
        deviation: The standard deviation.
    """

    name: str
    count: int
    low: float
    median: float
    high: float
    mean: float
    deviation: float


def summarise(splats: Splats) -> tuple[Statistics, ...]:
    """Return the distribution of every quantity of splats, such as opacity, with units."""
    return tuple(_field_statistics(name, _values(splats, name)) for name in FILTER_QUANTITIES)


def statistics_text(summary: Sequence[Statistics]) -> str:
    """Return the distributions of splat quantities as a text table."""
    columns = ("low", "median", "high", "mean", "deviation")
    lines = [f"{'':<15}" + "".join(f"{column:>12}" for column in columns)]
    for entry in summary:
        numbers = "".join(f"{getattr(entry, column):>12.4g}" for column in columns)
        lines.append(f"  {entry.name:<13}{numbers}")
    return "\n".join(lines)


def write_histograms(path: FilePath, splats: Splats) -> None:
    """Write a PNG image with the histograms of all splat quantities, and their extremes.

    Raises:
        NotSupported: Pillow is not installed.
        FileUnwritable: The file cannot be written.
    """
    try:
        from PIL import Image, ImageDraw
    except ImportError as error:
        raise NotSupported(
            "pictures of histograms need Pillow, which is not installed",
            where="histograms",
            hint="pip install 'gsgen[formats]'",
        ) from error
    width, height = _BIN_COUNT * _BAR_WIDTH + _MARGIN_PIXELS, _PLOT_HEIGHT + 2 * _MARGIN_PIXELS
    rows = -(-len(FILTER_QUANTITIES) // _COLUMN_COUNT)
    image = Image.new("RGB", (_COLUMN_COUNT * width + _MARGIN_PIXELS, rows * height), "white")
    draw = ImageDraw.Draw(image)
    for index, name in enumerate(FILTER_QUANTITIES):
        left_edge, top_edge = (
            _MARGIN_PIXELS + index % _COLUMN_COUNT * width,
            index // _COLUMN_COUNT * height,
        )
        values = _values(splats, name)
        counts, low, high = histogram(name, values)
        base = top_edge + _MARGIN_PIXELS + _PLOT_HEIGHT
        axis = ", logarithmic" if _LOG_SCALED_WORD in name else ""
        draw.text((left_edge, top_edge + 2), f"{name}: {low:.3g} to {high:.3g}{axis}", fill="black")
        for bar, count in enumerate(counts):
            bar_height = round(_PLOT_HEIGHT * count / max(counts.max(), 1))
            draw.rectangle(
                (
                    left_edge + bar * _BAR_WIDTH,
                    base - bar_height,
                    left_edge + bar * _BAR_WIDTH + _BAR_WIDTH - 2,
                    base,
                ),
                fill="#3465a4",
            )
        draw.line((left_edge, base, left_edge + _BIN_COUNT * _BAR_WIDTH, base), fill="black")
    stream = BytesIO()
    image.save(stream, "PNG")
    with replace_file(path) as file:
        file.write(stream.getvalue())


def histogram(name: str, values: Float64[np.ndarray, " n"]) -> tuple[np.ndarray, float, float]:
    """Return an 80-bin histogram of values with its range; bins of scales are logarithmic."""
    if not len(values):
        return np.zeros(_BIN_COUNT, np.int64), 0.0, 0.0
    low, high = float(values.min()), float(values.max())
    if _LOG_SCALED_WORD in name:
        values = np.log(values[values > 0])
    counts, _ = np.histogram(values, _BIN_COUNT)
    return counts, low, high


def _values(splats: Splats, name: str) -> Float64[np.ndarray, " n"]:
    with np.errstate(over="ignore"):
        values = np.asarray(FILTER_QUANTITIES[name](splats), np.float64)
    return values[np.isfinite(values)]


def _field_statistics(name: str, values: Float64[np.ndarray, " n"]) -> Statistics:
    if not len(values):
        values = np.full(1, np.nan)
    return Statistics(
        name=name,
        count=int(np.isfinite(values).sum()),
        low=float(values.min()),
        median=float(np.median(values)),
        high=float(values.max()),
        mean=float(values.mean()),
        deviation=float(values.std()),
    )

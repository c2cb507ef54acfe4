"""Rule GV048: view-dependent SH coefficients are in the column order of the contract."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Statistic, Violation
from gsgen.contract.validation.gates import COLORED_ROW_RULES, VALID_ROWS
from gsgen.contract.validation.rule import rule

# The statistic is the mean correlation of red, green and blue of the same coefficient: highlights
# are nearly grey, so right scenes have 0.8 to 0.95, and 0.0 in the other order. Both are near 0
# where colours were drawn at random, and the other one is exactly 1 where coefficients are copies.
_MIN_CORRELATION, _MAX_CORRELATION = 0.5, 0.9995
_MAX_CORRELATION_RATIO = 0.35
_SH1_CHANNELS = 12
# Coefficients of degree 1; blocks of so few numbers leave too little to compare.
_DEGREE_1_LENGTH = 4


@rule("GV048", Severity.WARNING, needs=(*VALID_ROWS, *COLORED_ROW_RULES, "GV014"))
def sh_rest_order(sample: DrawnSample) -> Iterator[Violation]:
    """Red, green and blue of each view-dependent SH coefficient are in adjacent columns.

    Why:
        A 3DGS PLY has f_dc first and then f_rest channel by channel: all red coefficients, all
        green, all blue. Copied as they are, highlights become rainbows that change with the camera;
        so they do if each degree is stored by channel.

    Hint:
        Transpose f_rest from [N, 3, K - 1] to [N, K - 1, 3], and put f_dc in front, as
        `gsgen fix MODEL --sh-order channel-major -o COPY` does. If the order is right, ignore this
        rule.
    """
    color = sample.even_row_color
    if color is None or not sample.emission.is_sh or color.shape[1] < _SH1_CHANNELS:
        return
    stored_correlation = _sh_correlation(color[:, 3:].reshape(len(color), -1, 3))
    correlation_by_sh_order = {
        name: _sh_correlation(sh_detail) for name, sh_detail in _possible_orders(color)
    }
    name = max(correlation_by_sh_order, key=correlation_by_sh_order.__getitem__)
    if (
        _MIN_CORRELATION < correlation_by_sh_order[name] < _MAX_CORRELATION
        and stored_correlation < _MAX_CORRELATION_RATIO * correlation_by_sh_order[name]
    ):
        actual = (
            f"red, green and blue of a coefficient correlate by {stored_correlation:.2f} as stored, and by "
            f"{correlation_by_sh_order[name]:.2f} if {name}"
        )
        expected = "a larger correlation as stored, coefficient by coefficient"
        location = Location(sample.emission.color_label, "degree 1 and above")
        min_correlation = _MAX_CORRELATION_RATIO * correlation_by_sh_order[name]
        yield Violation(
            where=location,
            expected=expected,
            actual=actual,
            certainty="possible",
            statistic=Statistic(
                "correlation of red, green and blue as stored", stored_correlation, min_correlation
            ),
        )


def _possible_orders(
    color: Float[np.ndarray, "e c"],
) -> Iterator[tuple[str, Float[np.ndarray, "e k 3"]]]:
    """Yield view-dependent SH coefficients in the column order of each file format, with names."""
    higher_degrees = color[:, 3:]
    yield "f_rest is read channel-major, as in a 3DGS PLY", _split_by_channel(higher_degrees)
    degrees = np.split(higher_degrees, [9, 24], axis=1)
    parts = [_split_by_channel(columns) for columns in degrees if columns.shape[1]]
    yield "each degree is read channel-major", np.concatenate(parts, axis=1)
    length = color.shape[1] // 3
    if length > _DEGREE_1_LENGTH:
        # Blocks of K numbers, of which the last one does not fit behind the others.
        remaining_channels = higher_degrees.shape[1] - 2 * length
        blocks = [
            higher_degrees[:, start : start + remaining_channels]
            for start in (0, length, 2 * length)
        ]
        yield f"f_rest is read in blocks of {length}", np.stack(blocks, axis=2)
    for step in (1, 2):
        columns = np.roll(color, -step, axis=1)[:, 3:]
        name = f"columns are read from number {step} on"
        yield name, columns.reshape(len(color), -1, 3)


def _split_by_channel(columns: Float[np.ndarray, "e c"]) -> Float[np.ndarray, "e k 3"]:
    return columns.reshape(len(columns), 3, -1).transpose(0, 2, 1)


def _sh_correlation(sh_detail: Float[np.ndarray, "e k 3"]) -> float:
    """Return the mean correlation of the colour channels of SH coefficients; 0 if constant."""
    centered_detail = sh_detail - sh_detail.mean(axis=0)
    deviation = np.sqrt(np.square(centered_detail).mean(axis=0))
    unit = centered_detail / np.where(deviation > 0, deviation, 1)
    pairs = ((0, 1), (0, 2), (1, 2))
    return float(np.mean([(unit[:, :, i] * unit[:, :, j]).mean(axis=0) for i, j in pairs]))

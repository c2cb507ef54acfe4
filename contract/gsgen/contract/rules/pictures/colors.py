"""Validation rules of colour: wrong conversions of SH and RGB, and colours not loaded."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.drawn_sample import SH_OFFSET, DrawnSample, displayed_colors
from gsgen.contract.spec.layout import OPACITY
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.spherical_harmonics import SH_DC
from gsgen.contract.validation.finding import Location, Statistic, Violation, line_hint
from gsgen.contract.validation.gates import COLORED_ROW_RULES, VALID_ROWS
from gsgen.contract.validation.rule import rule

_ROUNDING = 1e-3
# RGB taken for a constant term: from near 0 to near 1, never below 0 or above 1.
_MAX_NEAR_ZERO_COLOR, _MIN_NEAR_ZERO_SHARE, _MIN_SPREAD = 0.25, 0.02, 0.4
# A constant term multiplied by its basis function, as viewers do once more, stays below 0.5.
_MAX_GREY_SHARE, _MIN_SHARE_EACH_SIDE = 0.5, 0.1
# The fraction of channels that are brighter than white after the offset is added twice.
_MIN_BRIGHT_SHARE = 0.3
# The fraction of channels that viewers clip after a second division by the basis function.
_CLIP_MARGIN, _MIN_CLIPPED_SHARE = 0.1, 0.3
_MIN_BYTE_VALUE = 20.0


@rule("GV045", Severity.WARNING, needs=(*VALID_ROWS, *COLORED_ROW_RULES, "GV014"))
def sh_constant_converted(sample: DrawnSample) -> Iterator[Violation]:
    """The degree-0 SH coefficients do not look like RGB that was converted wrongly.

    Why:
        Viewers show 0.5 + 0.2821 · f_dc. RGB stored as f_dc shows no colour darker than grey; the
        offset added twice shows white; a factor too much shows grey, and one too few clips.

    Hint:
        Store f_dc = (rgb - 0.5) / 0.28209479 of colours from 0 to 1. If the scene has such colours,
        ignore this rule.
    """
    if not sample.emission.is_sh or sample.even_row_color is None:
        return
    constant = sample.even_row_color[:, :3]
    mistake, inverse = _diagnose_sh_constant(constant)
    if mistake:
        low, high = SH_OFFSET + SH_DC * float(constant.min()), SH_OFFSET + SH_DC * constant.max()
        actual = (
            f"DC from {constant.min():.3g} to {constant.max():.3g}, which shows as {low:.3g} "
            f"to {high:.3g}, as if {mistake}"
        )
        location = Location(sample.emission.color_label, "degree 0")
        expected = "colours that reach both halves of 0 to 1, and are rarely clipped"
        yield Violation(
            where=location,
            expected=expected,
            actual=actual,
            certainty="possible",
            hint=_undo_hint(inverse),
        )


def _undo_hint(inverse: str) -> str:
    """Return the hint to undo a conversion of the first three channels; empty without inverse."""
    line = line_hint(f"color[:, :3] = {inverse}")
    ignore = "If the scene has such colours, ignore this rule."
    return f"Convert once, or undo it. {line} {ignore}" if inverse else ""


def _diagnose_sh_constant(constant: Float[np.ndarray, "e 3"]) -> tuple[str, str]:
    """Return the wrong RGB-to-SH conversion that explains degree 0, and its inverse, or empty texts."""
    low, high = float(constant.min()), float(constant.max())
    displayed_rgb = SH_OFFSET + SH_DC * constant
    bright_share = float((displayed_rgb > 1).mean())
    clipped_share = float(
        ((displayed_rgb < -_CLIP_MARGIN) | (displayed_rgb > 1 + _CLIP_MARGIN)).mean()
    )
    dark_row_share = float((constant < _MAX_NEAR_ZERO_COLOR).mean())
    if high > _MIN_BYTE_VALUE and low >= 0:
        return "bytes 0 to 255 were stored as DC", "(color[:, :3] / 255 - 0.5) / 0.28209479"
    if low >= -_ROUNDING and high <= 1 + _ROUNDING:
        if dark_row_share >= _MIN_NEAR_ZERO_SHARE and high - low >= _MIN_SPREAD:
            return "RGB were stored as DC", "(color[:, :3] - 0.5) / 0.28209479"
    elif low >= -_ROUNDING and high <= 1 / SH_DC + _ROUNDING and bright_share >= _MIN_BRIGHT_SHARE:
        mistake = "0.5 had not been subtracted from RGB before the division"
        return mistake, "color[:, :3] - 0.5 / 0.28209479"
    elif (
        -_MAX_GREY_SHARE <= low < -_MIN_SHARE_EACH_SIDE
        and _MIN_SHARE_EACH_SIDE < high <= _MAX_GREY_SHARE
    ):
        return "DC had been multiplied by 0.2821 already", "color[:, :3] / 0.28209479"
    elif clipped_share >= _MIN_CLIPPED_SHARE:
        return "DC had been divided by 0.2821 once too often", "color[:, :3] * 0.28209479"
    return "", ""


@rule("GV046", Severity.WARNING, needs=(*VALID_ROWS, *COLORED_ROW_RULES))
def colors_loaded(sample: DrawnSample) -> Iterator[Violation]:
    """The colours of the Gaussians are not all zero, nor are all degree-0 SH coefficients.

    Why:
        All-zero SH show every Gaussian in the same grey, and all-zero RGB in black: the colours
        were not loaded. Where only degree 0 is zero, columns were read too early, such as the
        normals of a PLY, which are zero and stand before the colours.

    Hint:
        Load the colours before the export, by the names of their columns. A scene of one colour
        needs numbers other than zero.
    """
    stored_color = sample.even_row_color
    if stored_color is None or displayed_colors(sample) is None or stored_color[:, :3].any():
        return
    shade_name = "grey" if sample.emission.is_sh else "black"
    numbers = "all colours" if not stored_color.any() else "all coefficients of degree 0"
    actual = (
        f"{numbers} of {len(stored_color)} rows are zero, so everything is the same {shade_name}"
    )
    location = Location(sample.emission.color_label)
    yield Violation(where=location, expected="colours", actual=actual, certainty="possible")


# Colours of a photograph differ less between neighbours than between any two rows: the ratio of
# the mean squared differences is 0 for smooth and 1 for unrelated colours. Smooth: below the first.
# Unrelated: above the second.
_MAX_SMOOTH_ROUGHNESS, _MIN_UNRELATED_ROUGHNESS = 0.5, 0.75
# The columns whose order, ascending or descending, exporters sort rows by.
_SORT_COLUMNS = {"opacity": OPACITY, "x": 0, "y": 1, "z": 2}


@rule("GV047", Severity.WARNING, needs=(*VALID_ROWS, *COLORED_ROW_RULES))
def colors_follow_rows(sample: DrawnSample) -> Iterator[Violation]:
    """The rows of colours are in the order of the Gaussians to which they belong.

    Why:
        Rows and colours are matched by position. If one of them was sorted or filtered alone, every
        Gaussian has the colour of another one: the picture is coloured noise.

    Hint:
        Apply one permutation to positions, covariances, opacities and colours.
    """
    is_whole_scene = len(sample.rows) == len(sample.inner_indices) == sample.count
    if sample.color is None or not is_whole_scene:
        return  # the order of a part says nothing of the whole
    color = sample.color[:, :3]
    stored_roughness = _color_roughness(sample, color)
    if stored_roughness <= _MIN_UNRELATED_ROUGHNESS:
        return
    for name, column in _SORT_COLUMNS.items():
        for sign, direction in ((1, "ascending"), (-1, "descending")):
            order = np.argsort(sign * sample.rows[:, column], kind="stable")
            restored_color = np.empty_like(color)
            restored_color[order] = color
            roughness = _color_roughness(sample, restored_color)
            if roughness < _MAX_SMOOTH_ROUGHNESS:
                actual = (
                    f"colours of neighbours differ by {stored_roughness:.2f} of what any two rows do, and by "
                    f"{roughness:.2f} if colours are taken in the order of {direction} {name}"
                )
                expected = "colours in the order of the rows"
                location = Location(sample.emission.color_label)
                usual_statistic = Statistic(
                    "colour difference of neighbours",
                    stored_roughness,
                    0.0,
                    _MIN_UNRELATED_ROUGHNESS,
                )
                rows, minus = sample.emission.rows_label.removeprefix("output "), "-" * (sign < 0)
                order_of_rows = f"torch.argsort(torch.argsort({minus}{rows}[:, {column}]))"
                yield Violation(
                    where=location,
                    expected=expected,
                    actual=actual,
                    certainty="possible",
                    statistic=usual_statistic,
                    hint="Apply one permutation to positions, covariances, opacities and colours. "
                    + line_hint(f"rows = rows[{order_of_rows}]"),
                )
                return


def _color_roughness(sample: DrawnSample, color: Float[np.ndarray, "n 3"]) -> float:
    """Return the mean squared colour difference of neighbours, relative to that of random pairs."""
    variance = color.var(axis=0).sum()
    neighbour_difference = color[sample.neighbours[:, 0]] - color[sample.inner_indices]
    return (
        float(np.square(neighbour_difference).sum(axis=1).mean() / (2 * variance))
        if variance > 0
        else 0.0
    )


# sigmoid(0) and sigmoid(1): what a sigmoid makes of colours; and a range that is wide for them.
_SIGMOID_TWICE_RANGE, _MIN_RANGE_WIDTH = (0.5, 0.7311), 0.15
# Colours without their offset are exactly 0 in this share of all channels, and hardly above 0.5.
_MIN_ZERO_SHARE, _MAX_RGB_WITHOUT_OFFSET, _DARK_PERCENTILE = 0.15, 0.55, 99
# Scenes of a few chosen colours say nothing: they may well have zeros, and none above a half.
_MIN_DISTINCT_COLORS = 32
_MAX_COLOR_DIVIDED_TWICE = 1.02 / 255
# SH coefficients that were clipped to colours: of right scenes up to 0.1 of the channels are exactly
# 0 while others are exactly 1; of clipped coefficients 0.3 or more are 0, and 0.03 or more are 1.
_MIN_CLIPPED_ZEROS, _MIN_CLIPPED_ONES = 0.25, 0.02


@rule("GV063", Severity.WARNING, needs=(*VALID_ROWS, *COLORED_ROW_RULES, "GV012", "GV046"))
def rgb_converted_once(sample: DrawnSample) -> Iterator[Violation]:
    """Raw RGB look converted once from stored colours: not twice, and not without the offset 0.5.

    Why:
        A sigmoid of a colour lies between 0.5 and 0.7311: everything is pale. A division by 255 of
        colours from 0 to 1 leaves black. 0.2821 · f_dc without the 0.5 is negative for every colour
        darker than grey, and black after clamping.

    Hint:
        Apply the sigmoid or the division once, and add 0.5 to 0.2821 · f_dc. If the scene has such
        colours, ignore this rule.
    """
    if sample.emission.is_sh or sample.even_row_color is None:
        return
    rgb = sample.even_row_color[:, :3]
    mistake, inverse = _diagnose_rgb(rgb)
    if mistake:
        actual = f"RGB from {rgb.min():.3g} to {rgb.max():.3g}, as if {mistake}"
        where, expected = sample.emission.color_label, "colours that reach both halves of 0 to 1"
        hint = _undo_hint(inverse)
        yield Violation.at(where, actual, expected, certainty="possible", hint=hint)


def _diagnose_rgb(rgb: Float[np.ndarray, "e 3"]) -> tuple[str, str]:
    """Return the conversion error that RGB values suggest, and its inverse, or empty texts."""
    low, high = float(rgb.min()), float(rgb.max())
    if 0 < high <= _MAX_COLOR_DIVIDED_TWICE:
        return "they were divided by 255 twice", "color[:, :3] * 255"
    start, end = _SIGMOID_TWICE_RANGE
    if start - _ROUNDING <= low and high <= end + _ROUNDING and high - low >= _MIN_RANGE_WIDTH:
        return "the sigmoid was applied twice", "torch.logit(color[:, :3])"
    zeros = float((rgb == 0).mean())
    is_dark_image = np.percentile(rgb, _DARK_PERCENTILE) <= _MAX_RGB_WITHOUT_OFFSET
    if zeros >= _MIN_ZERO_SHARE and is_dark_image and len(np.unique(rgb)) > _MIN_DISTINCT_COLORS:
        return "0.5 had not been added to 0.2821 · f_dc", "color[:, :3] + 0.5"
    is_clipped = zeros >= _MIN_CLIPPED_ZEROS and float((rgb == 1).mean()) >= _MIN_CLIPPED_ONES
    if is_clipped and len(np.unique(rgb)) > _MIN_DISTINCT_COLORS:
        return "f_dc had been clipped to 0 to 1 in place of 0.5 + 0.2821 · f_dc", ""
    return "", ""

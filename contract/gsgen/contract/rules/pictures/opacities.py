"""Validation rules of opacity: a sigmoid applied twice, and colours multiplied by opacity."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.probing.drawn_sample import DrawnSample, displayed_colors
from gsgen.contract.spec.layout import OPACITY
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.spherical_harmonics import SH_DC
from gsgen.contract.validation.finding import Location, Statistic, Violation, line_hint
from gsgen.contract.validation.gates import COLORED_ROW_RULES, VALID_ROWS
from gsgen.contract.validation.rule import rule

# sigmoid(0) and sigmoid(1): what a sigmoid makes of opacities.
_SIGMOID_TWICE_RANGE = (0.5, 0.7311)
_ROUNDING = 1e-3
# Equal opacities say nothing of their activation.
_MIN_SPREAD = 0.08
# Logits that are clamped to [0, 1] are exactly 0 or 1 in at least these fractions of the live rows,
# and in between in the last one. A sigmoid gives neither, and rows that are culled have no 1.
_MIN_ZERO_SHARE, _MIN_ONE_SHARE, _MIN_BETWEEN_SHARE = 0.03, 0.2, 0.05

# Colours multiplied by opacity are never brighter than it. The rule applies if enough rows are
# transparent; the logarithms of both then correlate. Right scenes have up to 0.25, and a factor
# of opacity gives 0.9 to 1.
_MAX_TRANSPARENT_OPACITY, _MIN_TRANSPARENT_SHARE = 0.4, 0.08
_MIN_DARKER_SHARE = 0.995
_MIN_CORRELATION = 0.7
_MIN_BRIGHTNESS = 1e-3


@rule("GV043", Severity.WARNING, needs=VALID_ROWS)
def opacity_activated_once(sample: DrawnSample) -> Iterator[Violation]:
    """Opacities look like the result of one sigmoid: not of two, and not of clamped logits.

    Why:
        A sigmoid of an opacity lies between sigmoid(0) = 0.5 and sigmoid(1) = 0.7311: nothing is
        opaque any more, nothing is nearly transparent, and the scene looks like fog. Logits that
        were clamped to [0, 1] in place of a sigmoid are 0 or 1 in many rows: soft edges harden.

    Hint:
        Apply the sigmoid once, and do not clamp: opacities from a renderer or a file of activated
        values have it already.
    """
    opacity = sample.even_rows[:, OPACITY]
    low, high = float(opacity.min()), float(opacity.max())
    is_in_sigmoid_range = (
        _SIGMOID_TWICE_RANGE[0] - _ROUNDING <= low and high <= _SIGMOID_TWICE_RANGE[1] + _ROUNDING
    )
    location = Location(sample.emission.rows_label, "opacity")
    if is_in_sigmoid_range and high - low > _MIN_SPREAD:
        actual = f"opacities from {low:.4g} to {high:.4g}, as if the sigmoid were applied twice"
        expected = "opacities also below 0.5 or above 0.7311"
        yield Violation(
            where=location,
            expected=expected,
            actual=actual,
            certainty="possible",
            statistic=Statistic(
                "range of opacities", high - low, _SIGMOID_TWICE_RANGE[1] - _SIGMOID_TWICE_RANGE[0]
            ),
        )
        return
    share_of_zeros, share_of_ones = _zero_and_one_shares(sample)
    if (
        share_of_zeros >= _MIN_ZERO_SHARE
        and share_of_ones >= _MIN_ONE_SHARE
        and 1 - share_of_zeros - share_of_ones >= _MIN_BETWEEN_SHARE
    ):
        actual = (
            f"opacities are exactly 0 in {share_of_zeros:.0%} and exactly 1 in {share_of_ones:.0%} of the live rows, "
            "as if logits were clamped and had no sigmoid"
        )
        expected = "opacities between 0 and 1, as a sigmoid gives them"
        yield Violation(
            where=location,
            expected=expected,
            actual=actual,
            certainty="possible",
            statistic=Statistic("share of rows with opacity 1", share_of_ones, 0.0, _MIN_ONE_SHARE),
        )


def _zero_and_one_shares(sample: DrawnSample) -> tuple[float, float]:
    """Return the fractions of Gaussians (rows in use) with opacity exactly 0, and exactly 1."""
    assert sample.emission.gaussians is not None
    opacity = sample.emission.gaussians[: sample.emission.count, OPACITY]
    return float((opacity == 0).mean()), float((opacity == 1).mean())


@rule("GV044", Severity.WARNING, needs=(*VALID_ROWS, *COLORED_ROW_RULES, "GV012"))
def colors_without_opacity(sample: DrawnSample) -> Iterator[Violation]:
    """Colours are not premultiplied by opacity.

    Why:
        Renderers multiply by opacity when they blend. A premultiplied colour is multiplied twice,
        and transparent parts become dark.

    Hint:
        Divide the colours by opacity, or leave the multiplication out.
    """
    color = displayed_colors(sample)
    if color is None:
        return
    opacity, max_channel = sample.even_rows[:, OPACITY], color.max(axis=1)
    transparent_share = float((opacity < _MAX_TRANSPARENT_OPACITY).mean())
    darker_row_share = float((max_channel <= opacity * (1 + _ROUNDING)).mean())
    if (
        transparent_share < _MIN_TRANSPARENT_SHARE
        or darker_row_share < _MIN_DARKER_SHARE
        or np.ptp(max_channel) == 0
    ):
        return
    logarithms = np.log(np.maximum([max_channel, opacity], _MIN_BRIGHTNESS))
    correlation = float(np.corrcoef(logarithms)[0, 1])
    if correlation > _MIN_CORRELATION:
        actual = (
            f"no colour is brighter than its opacity in {darker_row_share:.1%} of {len(color)} rows, and "
            f"both correlate by {correlation:.2f}, as if colours were multiplied by opacity"
        )
        expected = f"transparent rows of any brightness, or a correlation below {_MIN_CORRELATION}"
        location = Location(sample.emission.color_label)
        yield Violation(
            where=location,
            expected=expected,
            actual=actual,
            certainty="possible",
            statistic=Statistic("correlation with opacity", correlation, high=_MIN_CORRELATION),
            hint=_divide_hint(sample),
        )


def _divide_hint(sample: DrawnSample) -> str:
    """Return the hint to divide the shown colours by the opacity."""
    opacity = f"{sample.emission.rows_label.removeprefix('output ')}[:, 3:4].clamp(1 / 255)"
    line = f"rows[:, :3] = rows[:, :3] / {opacity}"
    if sample.emission.is_sh:  # of 0.5 + SH_DC * x
        line = f"rows[:, :3] = ((0.5 + {SH_DC:.8g} * rows[:, :3]) / {opacity} - 0.5) / {SH_DC:.8g}"
    return f"Leave the multiplication out, or divide the colours by opacity. {line_hint(line)}"

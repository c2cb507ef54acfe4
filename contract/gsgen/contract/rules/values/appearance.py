"""Rules of appearance (GV): range of RGB, and order and magnitude of SH coefficients."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.spherical_harmonics import degree_of
from gsgen.contract.validation.finding import Location, Violation, line_hint
from gsgen.contract.validation.gates import APPEARANCE, COLORED_ROW_RULES
from gsgen.contract.validation.rule import rule

_COLOR_SLACK = 1e-2

# Mean degree of the coefficients' energy. Trained scenes lie below 0.3, since detail falls with
# the degree; a wrong order spreads the constant terms over all degrees and gives 1 or more.
_MIN_SUSPECT_BAND_RATIO = 0.5
_MAX_BAND_ENERGY_RATIO = 0.4

# Beyond what any colour needs; fewer than one in a hundred may be outliers.
_LARGE_COEFFICIENT = 10.0
_MAX_LARGE_SHARE = 0.01


@rule("GV012", Severity.ERROR, needs=COLORED_ROW_RULES)
def rgb_range(rows: Rows) -> Iterator[Violation]:
    """Raw RGB lies in [0, 1], or in the declared range, in every drawn row.

    Why:
        Values up to 255 are undivided bytes, and show as white; values around zero are SH
        coefficients, and show as black. Without a manifest the finding is possible.

    Hint:
        Divide bytes by 255; turn [-1, 1] into (x + 1) / 2, and the SH constant term into colour as
        0.5 + 0.28209479 · f_dc; clamp what a network gives beyond 1. Where the method itself clips
        the picture alone, declare the colours' `range`.
    """
    declared, color = rows.emission.declared, rows.color
    if declared is None or declared.space != "rgb" or color is None:
        return
    rgb = color[:, :3].astype(np.float32)
    low, high = declared.range or (0.0, 1.0)
    in_range_mask = ((rgb >= low - _COLOR_SLACK) & (rgb <= high + _COLOR_SLACK)).all(axis=1)
    is_inferred = rows.emission.subject.candidate is not None
    invalid = rows.drawn & ~in_range_mask
    expected, cause = f"{low:g} <= rgb <= {high:g}", None
    if invalid.any():
        from gsgen.contract.causes.activations import explain_rgb

        cause = explain_rgb(rgb[rows.drawn], low, high)
    yield Violation.rows(
        Location(rows.emission.color_label, "rgb"),
        invalid,
        rgb,
        expected,
        checked=rows.drawn_count,
        magnitude=np.nan_to_num(np.abs(rgb - 0.5).max(axis=1)),
        certainty="possible" if is_inferred else "confirmed",
        cause=cause,
    )


@rule("GV014", Severity.WARNING, needs=APPEARANCE)
def sh_order(emission: ModelOutputs) -> Iterator[Violation]:
    """SH coefficients are stored coefficient by coefficient, with red, green and blue innermost.

    Why:
        A 3DGS PLY stores all red coefficients first. Copied as they are, green and blue constants
        are read as view-dependent detail: colours change wildly with every step of the camera.

    Hint:
        Transpose [N, 3, K] to [N, K, 3] before flattening, with f_dc first. If the order is right and the scene is
        unusual, ignore this rule.
    """
    declared, sample = emission.declared, emission.shown_colors
    if declared is None or not emission.is_sh or emission.zeros:
        return
    if sample.shape[1] < 12 or not len(sample):  # a single coefficient has no order
        return
    coefficient_energy = np.square(sample).mean(axis=0, dtype=np.float64)
    if not coefficient_energy.sum() > 0:
        return
    spread = {
        name: _mean_degree(coefficient_energy[coefficient_slots])
        for name, coefficient_slots in _coefficient_orders(len(coefficient_energy)).items()
    }
    stored_degree = spread.pop("coefficient-major")
    name, min_degree = min(spread.items(), key=lambda item: item[1])
    if (
        stored_degree > _MIN_SUSPECT_BAND_RATIO
        and min_degree < _MAX_BAND_ENERGY_RATIO * stored_degree
    ):
        actual = f"energy lies at mean degree {stored_degree:.2f} as stored, {min_degree:.2f} if read {name}"
        expected = (
            f"a mean degree below {_MIN_SUSPECT_BAND_RATIO}, as coefficient-major SH of a scene has"
        )
        k = len(coefficient_energy) // 3
        swap = "rows.reshape(-1, {}, {}).transpose(1, 2).reshape(-1, {})"
        lines = {
            "channel-major": f"rows = {swap.format(3, k, 3 * k)}",
            "interleaved twice": f"rows = {swap.format(k, 3, 3 * k)}",
            "with f_rest before f_dc": f"rows = torch.cat([rows[:, {3 * k - 3}:], rows[:, :{3 * k - 3}]], 1)",
        }
        hint = f"Store SH coefficient by coefficient, f_dc first. {line_hint(lines[name])} If the order is right and the scene is unusual, ignore this rule."
        yield Violation.at(
            f"output {declared.name}", actual, expected, certainty="possible", hint=hint
        )


def _coefficient_orders(size: int) -> dict[str, np.ndarray]:
    """Map each storage order of SH coefficients to columns by coefficient and channel, [K, 3]."""
    k = size // 3
    flat_indices = np.arange(size)
    twice_interleaved_indices = (
        flat_indices % k
    ) * 3 + flat_indices // k  # interleaved a second time
    return {
        "coefficient-major": flat_indices.reshape(k, 3),
        "channel-major": flat_indices.reshape(3, k).T,
        "interleaved twice": twice_interleaved_indices.reshape(k, 3),
        "with f_rest before f_dc": np.roll(flat_indices, 3).reshape(k, 3),
    }


def _mean_degree(coefficient_energy: Float[np.ndarray, "k 3"]) -> float:
    count = len(coefficient_energy)
    degrees = np.repeat(np.arange(degree_of(count) + 1), 2 * np.arange(degree_of(count) + 1) + 1)
    return float((coefficient_energy.sum(axis=1) * degrees).sum() / coefficient_energy.sum())


@rule("GV013", Severity.WARNING, needs=APPEARANCE)
def sh_magnitude(emission: ModelOutputs) -> Iterator[Violation]:
    """SH coefficients above degree 0 are not far larger than visible colours allow.

    Why:
        A coefficient of 3 alone moves a colour from black to white within a turn of the camera.
        Coefficients beyond 10 are usually bytes, or quantised and never scaled back.

    Hint:
        Scale the coefficients as they were trained.
    """
    if not emission.is_sh or emission.shown_colors.shape[1] <= 3:
        return
    sh_detail = emission.shown_colors[:, 3:]
    if not len(sh_detail) or max(-sh_detail.min(), sh_detail.max()) <= _LARGE_COEFFICIENT:
        return
    sh_detail = np.abs(sh_detail)
    share = float(np.count_nonzero(sh_detail > _LARGE_COEFFICIENT) / max(sh_detail.size, 1))
    if share > _MAX_LARGE_SHARE:
        actual = f"{100 * share:.3g} % of coefficients beyond ±{_LARGE_COEFFICIENT:g}, up to {sh_detail.max():.3g}"
        expected = f"magnitudes up to {_LARGE_COEFFICIENT:g}"
        line = line_hint("rows[:, 3:] = rows[:, 3:] / 255")
        hint = f"Scale the coefficients as they were trained. If they are bytes: {line}"
        yield Violation.at(emission.color_label, actual, expected, certainty="possible", hint=hint)


@rule("GV022", Severity.INFO, needs=APPEARANCE)
def fourth_channel_unused(emission: ModelOutputs) -> Iterator[Violation]:
    """The fourth channel of RGB has the same value in all rows.

    Why:
        It only fills the row up to whole words, and no reader looks at it. Varying values there were
        meant to have an effect, such as an alpha, and have none.

    Hint:
        Put opacity in column 3 of the packed rows, and 1 in the fourth channel.
    """
    sample = emission.shown_colors
    if emission.is_sh or sample.shape[1] != 4 or not len(sample):
        return
    low, high = sample[:, 3].min(), sample[:, 3].max()
    if low != high:
        actual = f"values from {low:.3g} to {high:.3g} in channel 3"
        hint = f"Put opacity in column 3 of the packed rows. {line_hint('rows[:, 3] = 1')}"
        yield Violation.at(emission.color_label, actual, "one number in all rows", hint=hint)

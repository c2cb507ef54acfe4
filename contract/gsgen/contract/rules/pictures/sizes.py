"""Validation rules of size: standard deviations against the distance to the nearest neighbours."""

from collections.abc import Callable, Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.rules.pictures.alignment import MAX_FITTING_DEVIATION, measure_alignment
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Statistic, Violation, line_hint
from gsgen.contract.validation.gates import VALID_ROWS
from gsgen.contract.validation.rule import rule

# The statistic is the median of the longest standard deviation over the spacing, which is the mean
# distance to the three nearest neighbours. Right scenes lie between 0.1 (points far apart) and 2.2
# (anchors with ten Gaussians each); an initialisation by the spacing gives 1, dust 0.005 to 0.02.
_MIN_RATIO, _MAX_RATIO = 0.002, 5.0
# Discs that lie in the surface of their neighbours, and needles on their strand, are not dust: they
# leave holes below this. Right ones have 0.11 to 3.3.
_MAX_HOLE_AREA_RATIO = 0.05
# Within these limits, a scene is suspected only if one known mistake explains it: undone, the
# statistic lies in the narrower range that scenes without holes and without blur have.
_SMALL_SIZE_RATIO, _LARGE_SIZE_RATIO, _HUGE_SIZE_RATIO = 0.12, 0.8, 2.5
_USUAL_RATIO_RANGE = (0.25, 0.6)
# Gaussians that follow their neighbours are not dust: below the first, a mistake is undone up to the
# second.
_MAX_SPARSE_RATIO, _MAX_DENSE_RATIO = 0.1, 2.2
# A power of the sizes multiplies the spread of their logarithms: of right scenes 0.2 to 0.3, of sizes
# that an author chose nearly 0. Below this, a power is unlikely.
_MIN_POWER_SPREAD = 0.4
# Few Gaussians are far apart by their number: with fewer rows, wrong units are unlikely.
_MIN_DENSE_COUNT = 1000
# A square root makes discs and needles, whose shortest axis is below a tenth of the longest, about
# this thick. Other shapes are suspected only where their axes were written without a rotation.
_THICKNESS_RANGE = (0.17, 0.45)
_MAX_ROUND_THICKNESS = 0.83
# exp(exp(x)) is never below 1, and hardly above where scales are small.
_EXP_TWICE_RANGE = (0.999, 1.05)

# The blur that renderers add to variances on the screen, in pixels²: in a scene, it is a floor of
# the shortest axis that most discs and needles stand on.
_SCREEN_BLUR_RANGE, _MIN_BLURRED_SHARE = (0.2999, 0.301), 0.5

SigmaArray = Float[np.ndarray, "m 3"]


def _scale_by_factor(factor: float) -> Callable[[SigmaArray], SigmaArray]:
    return lambda sigma: sigma * factor


# The mistake, the interval of the statistic it is suspected in, and the function that undoes it.
_BLUR_TEXT = "0.3, the blur of renderers in pixels², were added to variances of the scene"
_BOTH_MULTIPLIED_TEXT = "positions and variances were both multiplied by 100"
_UNIT_TEXT, _UNIT_FACTORS = "positions were multiplied by {} and scales were not", (1000, 100, 10)
_NOT_SQUARED_TEXT = "standard deviations stand where variances belong"
_KNOWN_MISTAKES: tuple[tuple[str, tuple[float, float], Callable[[SigmaArray], SigmaArray]], ...] = (
    (
        "log scales were squared, and exp is missing",
        (_HUGE_SIZE_RATIO, np.inf),
        lambda sigma: np.exp(-sigma),
    ),
    (_NOT_SQUARED_TEXT, (_LARGE_SIZE_RATIO, np.inf), np.square),
    ("variances were squared once more", (0.0, _SMALL_SIZE_RATIO), np.sqrt),
    (
        "10 was raised to natural logarithms in place of e",
        (0.0, _SMALL_SIZE_RATIO),
        lambda sigma: sigma ** (1 / np.log(10)),
    ),
    *(
        (_UNIT_TEXT.format(factor), (0.0, _SMALL_SIZE_RATIO), revert_mistake)
        for factor, revert_mistake in ((f, _scale_by_factor(f)) for f in _UNIT_FACTORS)
    ),
    (_BOTH_MULTIPLIED_TEXT, (0.0, _SMALL_SIZE_RATIO), _scale_by_factor(10)),
)


@rule("GV040", Severity.WARNING, needs=(*VALID_ROWS, "GV049"))
def size_fits_spacing(sample: DrawnSample) -> Iterator[Violation]:
    """Gaussians are neither far larger nor far smaller than the distance to their neighbours.

    Why:
        Too small, they leave holes; too large, they blur: the scale was not activated, activated or
        squared twice, or has another unit. Of 1,000 random right scenes 3 are suspected; of
        standard deviations for variances the rule sees four in ten.

    Hint:
        Apply exp to log scales once, square standard deviations once, and multiply covariances by
        s² where positions are multiplied by s. If the scene is meant to be dust or fog, ignore this
        rule.
    """
    sigma, spacing = sample.sigma, sample.spacing
    ratio = float(np.median(sigma[:, 2] / spacing))
    actual = f"median standard deviation {ratio:.3g} of the distance to the neighbours"
    mistake = _find_mistake(sample, ratio)
    if mistake:
        actual += f", as if {mistake}"
    elif _MIN_RATIO <= ratio < _MAX_HOLE_AREA_RATIO and _are_aligned_with_neighbours(sample):
        actual += ", although they follow the surface or the strand of their neighbours"
    elif _MIN_RATIO <= ratio <= _MAX_RATIO:
        return
    is_ratio_suspected = (
        _MIN_RATIO <= ratio <= _MAX_RATIO
    )  # the limits hold; the shapes tell otherwise
    low, high = (
        (_SMALL_SIZE_RATIO, _LARGE_SIZE_RATIO) if is_ratio_suspected else (_MIN_RATIO, _MAX_RATIO)
    )
    usual_text = ", as right scenes mostly have" if is_ratio_suspected else ""
    expected = f"a size of {low} to {high:g} times the distance to the neighbours{usual_text}"
    location = Location(sample.emission.rows_label, "covariance")
    usual_statistic = Statistic(
        "median standard deviation over the spacing", ratio, _SMALL_SIZE_RATIO, _LARGE_SIZE_RATIO
    )
    yield Violation(
        where=location,
        expected=expected,
        actual=actual,
        certainty="possible",
        statistic=usual_statistic,
        hint=_line_of(mistake),
    )


def _line_of(mistake: str) -> str:
    """Return the hint to undo a mistake by a line; empty if no short line does."""
    matrices = "rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)"
    square = f"({matrices} @ {matrices}).reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]"
    lines = {
        _NOT_SQUARED_TEXT: f"rows[:, 4:] = {square}",
        _BLUR_TEXT: "rows[:, [4, 7, 9]] = rows[:, [4, 7, 9]] - 0.3",
        _BOTH_MULTIPLIED_TEXT: "rows[:, 4:] = rows[:, 4:] * 100",
    } | {_UNIT_TEXT.format(s): f"rows[:, 4:] = rows[:, 4:] * {s} * {s}" for s in _UNIT_FACTORS}
    return f"{line_hint(lines[mistake])} Or ignore this rule." if mistake in lines else ""


def _find_mistake(sample: DrawnSample, ratio: float) -> str:
    """Return the likely mistake behind wrong sizes of Gaussians; empty if unclear."""
    sigma, spacing = sample.sigma, sample.spacing
    if _EXP_TWICE_RANGE[0] <= sigma.min() <= _EXP_TWICE_RANGE[1] and ratio > _USUAL_RATIO_RANGE[1]:
        return "exp was applied twice: no standard deviation is below 1"
    variances = np.square(sigma[:, 0])
    is_blurred = (variances >= _SCREEN_BLUR_RANGE[0]) & (variances <= _SCREEN_BLUR_RANGE[1])
    if variances.min() >= _SCREEN_BLUR_RANGE[0] and is_blurred.mean() >= _MIN_BLURRED_SHARE:
        return _BLUR_TEXT
    largest = (
        _MAX_DENSE_RATIO
        if ratio < _MAX_SPARSE_RATIO and _are_aligned_with_neighbours(sample)
        else _USUAL_RATIO_RANGE[1]
    )
    for mistake, (low, high), revert_mistake in _KNOWN_MISTAKES:
        if high == _SMALL_SIZE_RATIO and not _may_be_too_small(sample, revert_mistake):
            continue
        corrected_ratio = float(np.median(revert_mistake(sigma).max(axis=1) / spacing))
        if mistake == _NOT_SQUARED_TEXT and not _may_be_square_roots(sample):
            continue
        if low < ratio < high and _USUAL_RATIO_RANGE[0] <= corrected_ratio <= largest:
            return mistake
    return ""


def _may_be_too_small(
    sample: DrawnSample, revert_mistake: Callable[[SigmaArray], SigmaArray]
) -> bool:
    """Return whether a mistake could have made sizes small that were right before.

    A power shows in the spread of the sizes, wrong units only where Gaussians are dense or follow
    their neighbours.
    """
    single_result, doubled_result = revert_mistake(np.array([1.0, 2.0]))
    if doubled_result == 2 * single_result:  # the mistake is a factor
        return sample.count >= _MIN_DENSE_COUNT or _are_aligned_with_neighbours(sample)
    return float(np.log(sample.sigma[:, 2]).std()) >= _MIN_POWER_SPREAD


def _are_aligned_with_neighbours(sample: DrawnSample) -> bool:
    """Return whether flat Gaussians lie in their neighbours' surface, or long ones on a strand."""
    alignment = measure_alignment(sample)
    return alignment is not None and alignment.deviation <= MAX_FITTING_DEVIATION


def _may_be_square_roots(sample: DrawnSample) -> bool:
    """Return whether Gaussians would have the shapes of discs or needles if sizes were squared."""
    thickness = float(np.median(sample.sigma[:, 0] / sample.sigma[:, 2]))
    is_thick = _THICKNESS_RANGE[0] <= thickness <= _THICKNESS_RANGE[1] and (
        sample.is_planar or sample.is_linear
    )
    is_axis_aligned = not sample.rows[:, [5, 6, 8]].any()
    return is_thick or (is_axis_aligned and thickness < _MAX_ROUND_THICKNESS)

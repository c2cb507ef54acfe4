"""Rules of resolution (GV, GI): positions on a coarse lattice, and ranges that float32 cannot divide."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.spec.layout import POSITION
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Statistic, Violation
from gsgen.contract.validation.gates import DECLARATION_RULES, VALID_ROWS
from gsgen.contract.validation.rule import rule

# Positions lie on a lattice if their differences are multiples of the smallest one, within this
# fraction of it, and it is this many steps of float32 long: shorter ones are steps of float32.
_MAX_LATTICE_ERROR, _LATTICE_STEPS = 0.02, 64
_MIN_AXES = 2
# A lattice shows if its step exceeds the thinnest axis, and this fraction of the middle one. In
# files that quantise positions, the fraction is below 0.05.
_MAX_VISIBLE_STEP = 0.1
# Gaussians on purpose on a grid, such as voxels, are not turned.
_MIN_TURNED_ANGLE = 0.5

# A range is divided too coarsely if float32 has fewer numbers in it than this.
_MIN_RANGE_STEPS = 64


@rule("GV049", Severity.WARNING, needs=(*VALID_ROWS, "GV009"))
def positions_not_on_lattice(sample: DrawnSample) -> Iterator[Violation]:
    """Positions of rotated Gaussians do not lie on a lattice coarser than the Gaussians' thickness.

    Why:
        Positions that were trained or stored in bfloat16, cast to integers or quantised to few bits
        lie on a lattice: surfaces become stairs, and thin Gaussians stand beside each other.

    Hint:
        Keep positions in float32 from the checkpoint to the file; quantise them with more bits. If
        the lattice is meant, ignore this rule.
    """
    position = sample.rows[:, POSITION]
    steps = [step for axis in range(3) if (step := _lattice_step(position[:, axis])) > 0]
    rotated_share = float((sample.rows[:, [5, 6, 8]] != 0).any(axis=1).mean())
    if len(steps) < _MIN_AXES or rotated_share < _MIN_TURNED_ANGLE:
        return
    step, thin_sigma, median_sigma = (
        min(steps),
        *(float(np.median(sample.sigma[:, i])) for i in (0, 1)),
    )
    if step > thin_sigma and step > _MAX_VISIBLE_STEP * median_sigma:
        actual = (
            f"positions are multiples of {step:.4g} along {len(steps)} axes, {step / thin_sigma:.3g} times "
            "the smallest standard deviation, as bfloat16, integers or a coarse grid leave them"
        )
        expected = "a precision finer than the smallest standard deviation"
        location = Location(sample.emission.rows_label, "position")
        yield Violation(
            where=location,
            expected=expected,
            actual=actual,
            certainty="possible",
            statistic=Statistic(
                "step over the smallest standard deviation", step / thin_sigma, 0.0, 1.0
            ),
        )


def _lattice_step(values: Float[np.ndarray, " n"]) -> float:
    """Return the step of the regular grid on which all values lie; 0 if there is no such grid."""
    distinct_values = np.unique(values)
    if len(distinct_values) < _MIN_AXES + 1:
        return 0.0
    step = float(np.diff(distinct_values).min())
    if step < _LATTICE_STEPS * np.spacing(np.float32(np.abs(distinct_values).max())):
        return 0.0
    spacing_multiples = (distinct_values - distinct_values[0]) / step
    return (
        step
        if np.abs(spacing_multiples - np.rint(spacing_multiples)).max() < _MAX_LATTICE_ERROR
        else 0.0
    )


@rule("GI045", Severity.WARNING, needs=(*DECLARATION_RULES, "GI025"))
def range_resolved(subject: InspectedModel) -> Iterator[Violation]:
    """The declared range of a float32 input contains enough float32 numbers for smooth change.

    Why:
        Float32 has steps of 128 at 1.7 billion, the seconds since 1970. A range of ten seconds
        there holds one number: time stands still.

    Hint:
        Count from the start of the recording, and let the range begin at 0.
    """
    for entry in subject.manifest.inputs if subject.manifest else ():
        tensor = subject.graph.input(entry.name)
        if entry.range is None or tensor is None or tensor.dtype != "float32":
            continue
        low, high = entry.range
        step = float(np.spacing(np.float32(max(abs(low), abs(high)))))
        if 0 < high - low < _MIN_RANGE_STEPS * step:
            actual = f"float32 has steps of {step:g} in the range {low:g} to {high:g}"
            expected = f"{_MIN_RANGE_STEPS} steps or more within the range"
            yield Violation.at(f"input {entry.name}", actual, expected, certainty="possible")

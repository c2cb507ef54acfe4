"""Rules of covariance (GV): every drawn Gaussian is an ellipsoid."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Bool
from gsgen.contract.probing.outputs import Rows
from gsgen.contract.rules.values.range_diagnosis import diagnose_variances
from gsgen.contract.spec.geometry import smallest_eigenvalue
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Violation
from gsgen.contract.validation.gates import ORDERED_ROWS
from gsgen.contract.validation.rule import rule

# Negative eigenvalues within rounding, by item size: relative to the trace, and absolute for
# three entries that are each off by half of the smallest float16 step, 2⁻²⁴.
PSD_SLACK = {2: 2.0**-10, 4: 1e-5}
PSD_FLOOR = {2: 3 * 2.0**-25, 4: 0.0}
# The rounding error of a determinant in float32, relative to its largest terms, and the size
# below which terms lose bits.
_DET_RELATIVE_ERROR = np.float32(2e-6)
_DET_FLOOR = np.float32(1e-30)


@rule("GV005", Severity.ERROR, needs=ORDERED_ROWS)
def variance_not_negative(rows: Rows) -> Iterator[Violation]:
    """The variances xx, yy and zz of every drawn row are not negative.

    Why:
        A negative variance has no axes: the projected ellipse is NaN or covers the screen.

    Hint:
        Build the covariance as R S Sᵀ Rᵀ of standard deviations (exp of log scales), and check the
        order of the six entries: xx xy xz yy yz zz.
    """
    min_variance = rows.covariance[[0, 3, 5]].min(axis=0)
    invalid = rows.drawn & ~(min_variance >= 0)
    expected = "xx, yy, zz >= 0"
    if invalid.any():
        expected += diagnose_variances(rows.covariance[[0, 3, 5]][:, rows.drawn].T)
    yield Violation.rows(
        Location(rows.emission.rows_label, "covariance"),
        invalid,
        min_variance,
        expected,
        checked=rows.drawn_count,
        magnitude=-min_variance,
    )


@rule("GV006", Severity.ERROR, needs=ORDERED_ROWS)
def covariance_psd(rows: Rows) -> Iterator[Violation]:
    """The covariance of every drawn row is positive semi-definite, up to rounding.

    Why:
        A renderer clamps the smaller eigenvalue of the projected ellipse, which hides the fault
        until the other axis is hundreds of pixels long: a spike.

    Hint:
        Build the covariance as R S Sᵀ Rᵀ with a normalised rotation; in float16, scale the scene
        so that variances do not underflow.
    """
    slack, eigenvalue_floor = PSD_SLACK[rows.packed.itemsize], PSD_FLOOR[rows.packed.itemsize]
    has_variances = (rows.covariance[[0, 3, 5]] >= 0).all(axis=0)  # GV005 reports the others
    suspects = np.flatnonzero(rows.drawn & has_variances & ~_psd_mask(rows, slack))
    indefinite_mask = np.zeros(len(rows), bool)
    min_eigenvalue = np.zeros(len(rows))
    if len(suspects):
        upper = rows.covariance[:, suspects].T.astype(np.float64)
        trace = upper[:, [0, 3, 5]].sum(axis=1)
        min_eigenvalue[suspects] = smallest_eigenvalue(upper)
        indefinite_mask[suspects] = ~(min_eigenvalue[suspects] >= -slack * trace - eigenvalue_floor)
    yield Violation.rows(
        Location(rows.emission.rows_label, "covariance"),
        indefinite_mask,
        min_eigenvalue,
        f"smallest eigenvalue >= -{slack:.2g} of the trace",
        checked=rows.drawn_count,
        magnitude=-min_eigenvalue,
    )


def _psd_mask(rows: Rows, slack: float) -> Bool[np.ndarray, " n"]:
    """Return the mask of rows whose covariance clearly passes Sylvester's criterion, with slack."""
    xx, xy, xz, yy, yz, zz = rows.covariance
    diagonal_slack = np.float32(slack) * rows.trace
    a, b, c = xx + diagonal_slack, yy + diagonal_slack, zz + diagonal_slack
    minor = a * b - xy * xy
    subtracted_terms = a * yz * yz + b * xz * xz
    det = c * minor - subtracted_terms + 2 * xy * xz * yz
    det_error = np.maximum(_DET_RELATIVE_ERROR * (a * b * c + subtracted_terms), _DET_FLOOR)
    return np.asarray((a > 0) & (minor > 0) & (det > det_error))


@rule("GV007", Severity.WARNING, needs=ORDERED_ROWS)
def covariance_not_zero(rows: Rows) -> Iterator[Violation]:
    """No drawn row has a covariance of all zeros.

    Why:
        The Gaussian has no extent of its own and shows only as the renderer's low-pass filter. A
        zero quaternion, or float16 underflow of a variance below 6e-8, gives such rows.

    Hint:
        Normalise rotations safely; scale the scene up before float16.
    """
    yield Violation.rows(
        Location(rows.emission.rows_label, "covariance"),
        rows.drawn & (rows.trace == 0) & (rows.covariance == 0).all(axis=0),
        rows.trace,
        "a trace above 0",
        checked=rows.drawn_count,
    )

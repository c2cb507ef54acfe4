"""Rules of covariance (GV): every drawn Gaussian is an ellipsoid."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.probing.outputs import Rows
from gsgen.contract.spec.geometry import PSD_FLOOR, PSD_SLACK, clearly_positive, smallest_eigenvalue
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Violation
from gsgen.contract.validation.gates import ORDERED_ROWS
from gsgen.contract.validation.rule import rule


@rule("GV005", Severity.ERROR, needs=ORDERED_ROWS, at_moments=True)
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
    cause = None
    if invalid.any():
        from gsgen.contract.causes.activations import explain_variances

        cause = explain_variances(rows.covariance[:, rows.drawn].T)
    yield Violation.rows(
        Location(rows.emission.rows_label, "covariance"),
        invalid,
        min_variance,
        "xx, yy, zz >= 0",
        checked=rows.drawn_count,
        magnitude=-min_variance,
        cause=cause,
        can_be_zeroed=True,
    )


@rule("GV006", Severity.ERROR, needs=ORDERED_ROWS, at_moments=True)
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
    suspects = np.flatnonzero(
        rows.drawn & has_variances & ~clearly_positive(rows.covariance, slack)
    )
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
        can_be_zeroed=True,
    )


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
        can_be_zeroed=True,
    )

"""Validation rules of a camera that rotates about its own centre: only culling may change."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.behaviour_probes import LOOKING_AWAY_LABEL, TILTED_LABEL
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun
from gsgen.contract.spec.layout import COVARIANCE, CULL_OPACITY, OPACITY, POSITION, VARIANCES
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Statistic, Violation
from gsgen.contract.validation.gates import REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# Rows that are drawn at the same place before and after the turn; fewer say nothing.
_MIN_ROWS = 8
# The statistic is the change that a tenth of the rows exceeds: of a colour in 0 to 1, and of a
# covariance relative to its trace. The median would miss light that is clamped on the half that
# faces away. Right models have 1e-6, from rounding of the matrix; wrong ones 0.03 to 0.9.
_MIN_PIXEL_CHANGE = 0.01
_CHANGE_QUANTILE = 0.9


@rule("GB030", Severity.WARNING, needs=(*REPRODUCIBLE, "GI001", "GI007", "GM006", "GO001", "GO002"))
def turning_in_place_changes_nothing(behaviour: Behaviour) -> Iterator[Violation]:
    """Rotating the camera about its centre changes no colour and no covariance of drawn Gaussians.

    Why:
        The direction to a Gaussian does not depend on where the camera looks. A change means a
        wrong centre: the view matrix was taken for camera-to-world, or its rotation left out,
        transposed or mirrored. Covariances that turn are in camera space.

    Hint:
        The view matrix is world-to-camera: its camera's centre is −Rᵀ t. Take directions from
        there to each row, and emit covariances in local space, as positions are.
    """
    runs = [run for run in behaviour.trial_runs("turned") if run.probe.label.endswith(TILTED_LABEL)]
    base = _outputs(behaviour.subject, behaviour.base)
    for run in runs:
        turned_outputs = _outputs(behaviour.subject, run)
        if base is None or turned_outputs is None:
            return
        rows = _rows_drawn_in_both(base, turned_outputs)
        if np.count_nonzero(rows) < _MIN_ROWS:
            return
        yield from _field_changes(base, turned_outputs, rows)


def _field_changes(
    base: ModelOutputs, turned_outputs: ModelOutputs, rows: Bool[np.ndarray, " n"]
) -> Iterator[Violation]:
    assert base.gaussians is not None
    assert turned_outputs.gaussians is not None
    color, other_color = base.appearance, turned_outputs.appearance
    if color is not None and other_color is not None and color.shape == other_color.shape:
        changes = np.abs(color[rows].astype(float) - other_color[rows]).max(axis=1)
        change = float(np.quantile(changes, _CHANGE_QUANTILE))
        if change > _MIN_PIXEL_CHANGE:
            actual = (
                f"a tenth of the colours changes by {change:.3g} or more while the "
                "camera turns about its own centre, as if its centre were computed without the inverse rotation"
            )
            usual_statistic = Statistic("change of colour", change, 0.0, _MIN_PIXEL_CHANGE)
            expected = "the same colours from the same centre"
            yield _possible_violation(base.color_label, "", actual, expected, usual_statistic)
    a, b = (
        o.gaussians[rows].astype(float) for o in (base, turned_outputs) if o.gaussians is not None
    )
    trace = np.maximum(a[:, VARIANCES].sum(axis=1), np.finfo(np.float32).tiny)
    changes = np.abs(a[:, COVARIANCE] - b[:, COVARIANCE]).max(axis=1) / trace
    change = float(np.quantile(changes, _CHANGE_QUANTILE))
    if change > _MIN_PIXEL_CHANGE:
        actual = (
            f"a tenth of the covariances changes by {change:.3g} of the trace or "
            "more while the camera turns about its own centre, as if they were in camera space"
        )
        usual_statistic = Statistic("change over trace", change, 0.0, _MIN_PIXEL_CHANGE)
        expected = "covariances in local space"
        yield _possible_violation(base.rows_label, "covariance", actual, expected, usual_statistic)


def _possible_violation(
    subject: str, field: str, actual: str, expected: str, statistic: Statistic
) -> Violation:
    return Violation(
        where=Location(subject, field),
        actual=actual,
        expected=expected,
        certainty="possible",
        statistic=statistic,
    )


def _outputs(subject: InspectedModel, run: ProbeRun) -> ModelOutputs | None:
    """Return the outputs of a model run; None if the run failed or has no packed rows."""
    outputs = read_outputs(subject, run.probe.label, run.outputs)
    return outputs if outputs.gaussians is not None else None


def _drawn_mask(outputs: ModelOutputs) -> Bool[np.ndarray, " n"]:
    assert outputs.gaussians is not None
    rows = outputs.gaussians
    live_mask = np.arange(len(rows)) < outputs.count
    return np.asarray(
        live_mask & (rows[:, OPACITY] >= CULL_OPACITY) & np.isfinite(rows).all(axis=1)
    )


def _rows_drawn_in_both(first: ModelOutputs, second: ModelOutputs) -> Bool[np.ndarray, " n"]:
    """Return the mask of Gaussians that are drawn at the same position in two model runs."""
    a, b = first.gaussians, second.gaussians
    assert a is not None
    assert b is not None
    if a.shape != b.shape:
        return np.zeros(len(a), bool)
    is_same_center = _same_position(a[:, POSITION].astype(float), b[:, POSITION].astype(float))
    return np.asarray(_drawn_mask(first) & _drawn_mask(second) & is_same_center)


def _same_position(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    rounding = 1e-6 * np.maximum(np.abs(a).max(axis=1, initial=0), np.abs(b).max(axis=1, initial=0))
    return np.asarray(np.abs(a - b).max(axis=1, initial=0) <= rounding)


@rule(
    "GB031",
    Severity.WARNING,
    needs=(*REPRODUCIBLE, "GI001", "GI007", "GM006", "GO001", "GO002", "GV054"),
)
def forward_axis(behaviour: Behaviour) -> Iterator[Violation]:
    """A camera that looks at the scene draws more Gaussians than one that looks away from it.

    Why:
        A camera of the contract looks along +z, one of OpenGL along −z. Culled with the wrong sign,
        all that lies ahead is hidden, and all that lies behind is drawn.

    Hint:
        Keep rows whose depth along +z is positive.
    """
    runs = [
        run
        for run in behaviour.trial_runs("turned")
        if run.probe.label.endswith(LOOKING_AWAY_LABEL)
    ]
    base = _outputs(behaviour.subject, behaviour.base)
    for run in runs:
        turned_away_outputs = _outputs(behaviour.subject, run)
        if base is None or turned_away_outputs is None:
            return
        count_in_front, behind_count = (
            int(_drawn_mask(base).sum()),
            int(_drawn_mask(turned_away_outputs).sum()),
        )
        if behind_count >= _MIN_ROWS and count_in_front < behind_count / 2:
            actual = (
                f"{count_in_front} rows are drawn by a camera that looks at the scene, and {behind_count} by one "
                "that looks away, as if culling took −z for forward"
            )
            usual_statistic = Statistic(
                "rows ahead over rows behind", count_in_front / behind_count, 0.5
            )
            yield _possible_violation(
                base.rows_label, "opacity", actual, "rows ahead, along +z", usual_statistic
            )

"""Rules of cameras (GI, GB): matrix order, projection sign, and conservative culling."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract._array_types import Bool, Float
from gsgen.contract.probing.differences import largest_difference
from gsgen.contract.probing.probes import as_tensor
from gsgen.contract.probing.run_comparison import Behaviour
from gsgen.contract.probing.survey_probes import SIDE_LABEL
from gsgen.contract.spec.layout import CULL_OPACITY, OPACITY, POSITION, VARIANCES
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# A cone in front of every camera: half the opening of the narrowest lens.
_CONE_SLOPE = 0.2
_NEAR_DISTANCE = 0.1
_MIN_CULLED_SHARE = 0.01
# Of the hidden rows, a sample is compared with the drawn ones: a method that fades rows, or replaces
# them by others, leaves few of them bare (0 to 0.11 in exports), culling leaves most (0.75 and more).
_SAMPLE_ROWS = 64
_COVERED_SIGMAS = 2.0
_MAX_BACKGROUND_SHARE = 0.4


@rule("GI007", Severity.ERROR, needs=(*REPRODUCIBLE, "GI001", "GM006"))
def matrix_order(behaviour: Behaviour) -> Iterator[Violation]:
    """The model reads the view matrix in the memory order that the manifest declares.

    Why:
        The same sixteen numbers are a matrix or its transpose. Read as the other one, the
        translation is lost and the rotation turned around: the camera seems to stand still at the
        origin.

    Hint:
        Declare the order that the model reads as space.matrix_order, or transpose inside the model.
    """
    runs = behaviour.trial_runs("moved")
    if len(runs) < 3 or not all(run.digest for run in runs):
        return
    base_digest, moved_digest, transposed = (run.digest for run in runs)
    space = behaviour.subject.generator.space if behaviour.subject.generator else None
    order = space.matrix_order if space else "column"
    if moved_digest == base_digest and transposed != base_digest:
        actual = f"a moved camera changes nothing, read in {order} order; transposed it does"
        name = next(iter(behaviour.subject.inputs_of("view")))[0].name
        yield Violation.at(f"input {name}", actual, f"the {order} order, as declared")


@rule("GI008", Severity.WARNING, needs=(*REPRODUCIBLE, "GI002"))
def projection_y_sign(behaviour: Behaviour) -> Iterator[Violation]:
    """Negating the y axis of clip space in the projection matrix changes no output.

    Why:
        Some hosts pass a projection with +y up, some with +y down, and a generator has no use for
        the sign: culling and level of detail are the same for both.

    Hint:
        Use absolute values of clip coordinates, or the view matrix alone.
    """
    runs = behaviour.trial_runs("flipped")
    if len(runs) < 2 or not all(run.digest for run in runs):
        return
    unflipped_run, flipped_run = runs
    if unflipped_run.digest != flipped_run.digest:
        for name, value in unflipped_run.outputs.items():
            largest = largest_difference(value, flipped_run.outputs[name])
            if largest > 0:
                actual = f"differs by up to {largest:.3g} with row 1 of the projection negated"
                yield Violation.at(f"output {name}", actual, "the same for both signs")


@rule("GB008", Severity.WARNING, needs=(*REPRODUCIBLE, "GO001", "GO002", "GI007", "GM006", "GV017"))
def culling_conservative(behaviour: Behaviour) -> Iterator[Violation]:
    """If another camera draws a Gaussian well inside the view, it or a Gaussian near it is drawn.

    Why:
        Models cull what their camera cannot see by setting its opacity to zero. Culling with a
        wrong matrix, sign or margin makes holes in the picture that move with the camera. Rows that
        fade among others, or that coarser ones replace, leave no hole: within two standard
        deviations of a drawn row, nothing is missing.

    Hint:
        Cull behind the camera and outside the frustum widened by a tenth; check the matrix order
        and that +z is forward.
    """
    subject = behaviour.subject
    declared, views = subject.declared_gaussians, subject.inputs_of("view")
    space = subject.generator.space if subject.generator else None
    if declared is None or not views or space is None:
        return
    probed_rows = [
        (probe, np.asarray(outputs[declared.name], np.float32))
        for probe, outputs in behaviour.variants("view")
    ]
    drawn = [rows[:, OPACITY] >= CULL_OPACITY for _, rows in probed_rows]
    for index, (probe, rows) in enumerate(probed_rows):
        matrix = as_tensor(probe.inputs[views[0][0].name], space.matrix_order)
        is_hidden_in_view = _cone_mask(rows[:, POSITION], matrix) & (rows[:, OPACITY] == 0)
        is_drawn_elsewhere = np.zeros(len(rows), bool)
        for other_index, (_, other_rows) in enumerate(probed_rows):
            if other_index != index and other_rows.shape == rows.shape:
                is_same_center = (other_rows[:, POSITION] == rows[:, POSITION]).all(axis=1)
                is_drawn_elsewhere |= is_same_center & drawn[other_index]
        hidden_rows = is_hidden_in_view & is_drawn_elsewhere
        culled_count = int(np.count_nonzero(hidden_rows))
        is_culling_significant = culled_count > _MIN_CULLED_SHARE * max(
            int(np.count_nonzero(drawn[index])), 1
        )
        if (
            is_culling_significant
            and _uncovered_share(rows[hidden_rows], rows[drawn[index]]) > _MAX_BACKGROUND_SHARE
        ):
            actual = (
                f"{culled_count} rows in the middle of the view have opacity 0 at {probe.label!r}, and "
                "nothing is drawn in place of them"
            )
            expected = "an opacity above 0, as other cameras get"
            yield Violation.at(f"output {declared.name}", actual, expected, certainty="possible")


def _uncovered_share(
    hidden_rows: Float[np.ndarray, "m 10"], drawn: Float[np.ndarray, "n 10"]
) -> float:
    """Return the fraction of culled Gaussians whose centre lies within no drawn Gaussian."""
    if not len(drawn):
        return 1.0
    size = np.square(_COVERED_SIGMAS) * drawn[:, list(VARIANCES)].max(axis=1)
    sample = hidden_rows[:: max(1, len(hidden_rows) // _SAMPLE_ROWS), POSITION]
    squared_distances = (np.square(drawn[:, POSITION] - centre).sum(axis=1) for centre in sample)
    return float(np.mean([not (square <= size).any() for square in squared_distances]))


def _cone_mask(
    position: Float[np.ndarray, "n 3"], view: Float[np.ndarray, "4 4"]
) -> Bool[np.ndarray, " n"]:
    x, y, z = (position @ view[:3, :3].T + view[:3, 3]).T
    return np.asarray(
        (z > _NEAR_DISTANCE) & (np.abs(x) < _CONE_SLOPE * z) & (np.abs(y) < _CONE_SLOPE * z)
    )


@rule("GV017", Severity.WARNING, needs=("GV025", "GO010", "GO011", "GV016"))
def count_not_zero(behaviour: Behaviour) -> Iterator[Violation]:
    """No camera that sees the declared bounds gets 0 Gaussians if other cameras get some.

    Why:
        These probes look at the middle of the bounds. A count of zero for some of them is culling
        with a wrong matrix or sign.

    Hint:
        Check the matrix order, and that +z is forward.
    """
    subject = behaviour.subject
    declared = subject.declared_count
    roles = ("view", "projection", "camera_position")
    if declared is None or not any(subject.inputs_of(role) for role in roles):
        return
    counts = {
        probe.label: int(outputs[declared.name].reshape(-1)[0])
        for probe, outputs in behaviour.probe_outputs
    }
    counts |= {
        run.probe.label: run.row_count.count
        for run in behaviour.trial_runs("survey")
        if run.row_count is not None and run.probe.label.startswith(SIDE_LABEL)
    }
    empty_view_labels = [label for label, count in counts.items() if count == 0]
    if empty_view_labels and len(empty_view_labels) < len(counts):
        actual = (
            f"0 at {len(empty_view_labels)} of {len(counts)} probes, first {empty_view_labels[0]!r}"
        )
        expected = "rows for every camera that sees the bounds"
        yield Violation.at(f"output {declared.name}", actual, expected, certainty="possible")

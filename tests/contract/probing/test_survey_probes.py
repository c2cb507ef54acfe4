"""Survey probes: where their cameras stand, which ends their inputs take, and what is kept."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.probing.probes import CameraPlacement, Probe, as_tensor, default_probes
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.probing.survey_probes import SIDE_LABEL, survey_probes
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.geometry import look_at
from gsgen.contract.spec.manifest import Bounds, Input, Space
from support.models.small_models import manifest_of, model, save

VIEW = Input(name="view", role="view")
EYE = Input(name="eye", role="camera_position")
TIME = Input(name="time", role="time", range=(2.0, 4.0))
SLIDERS = Input(name="sliders", role="control", range=(-1.0, 3.0), shape=(6,))
SHAPES = {"view": (4, 4), "eye": (3,), "time": (1,), "sliders": (6,)}
LOW, HIGH = np.array([-1.0, 2.0, 5.0]), np.array([3.0, 4.0, 6.0])


def surveyed(*inputs, order="column", limit=100, **declared):
    bounds = Bounds(tuple(LOW), tuple(HIGH))
    space = Space(matrix_order=order)
    manifest = replace(manifest_of(1), inputs=inputs, space=space, bounds=bounds, **declared)
    first = default_probes(manifest, SHAPES, dict.fromkeys(SHAPES, "float32"))
    return list(survey_probes(manifest, first, limit))


def eye_of(view):
    return -view[:3, :3].astype(np.float64).T @ view[:3, 3]


@pytest.mark.parametrize("order", ["column", "row"])
def test_cameras_stand_inside_far_away_and_on_twenty_sides(order):
    probes = surveyed(VIEW, order=order)
    assert len(probes) == 27
    views = [as_tensor(probe.inputs["view"], order) for probe in probes]
    for view in views:
        np.testing.assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-6)
        assert np.linalg.det(view[:3, :3]) == pytest.approx(1, abs=1e-5)
    center, diagonal = (LOW + HIGH) / 2, np.linalg.norm(HIGH - LOW)
    np.testing.assert_allclose(eye_of(views[0]), center, atol=1e-5)
    assert np.linalg.norm(eye_of(views[2]) - center) == pytest.approx(20 * diagonal, rel=1e-5)
    inside = [((eye_of(v) > LOW) & (eye_of(v) < HIGH)).all() for v in views]
    assert sum(inside) == 8
    sides = np.array([view[2, :3] for view in views[7:]])
    # No two of twenty points of a dodecahedron are nearer than 41.8 degrees.
    cosine = sides @ sides.T - 2 * np.eye(20)
    assert cosine.max() == pytest.approx(np.sqrt(5) / 3, abs=1e-5)
    looking_at_it = [*views[2:5], *views[7:]]
    for view in looking_at_it:
        if ((eye_of(view) > LOW) & (eye_of(view) < HIGH)).all():
            continue
        view_target = view[:3, :3] @ center + view[:3, 3]
        np.testing.assert_allclose(view_target[:2], 0, atol=1e-3)
        assert view_target[2] > 0


def test_labels_say_whether_a_camera_stands_within_the_bounds():
    sides = [probe for probe in surveyed(VIEW) if "side" in probe.label]
    assert len(sides) == 20
    for probe in sides:
        eye = eye_of(as_tensor(probe.inputs["view"], "column"))
        is_inside = bool(((eye > LOW) & (eye < HIGH)).all())
        assert probe.label.startswith("from within, side" if is_inside else SIDE_LABEL)


def test_a_camera_position_is_that_of_the_view():
    for probe in surveyed(VIEW, EYE):
        view = as_tensor(probe.inputs["view"], "column")
        np.testing.assert_allclose(eye_of(view), probe.inputs["eye"], rtol=1e-4, atol=1e-3)


def test_inputs_take_combinations_of_the_ends_of_their_ranges():
    probes = surveyed(VIEW, TIME, SLIDERS)[7:]
    numbers = np.array([np.r_[probe.inputs["time"], probe.inputs["sliders"]] for probe in probes])
    assert set(numbers[:, 0]) == {2.0, 4.0}
    assert all(set(column) == {-1.0, 3.0} for column in numbers[:, 1:].T)
    assert len(np.unique(numbers, axis=0)) > 15  # and not two corners alone


def test_a_model_without_camera_is_surveyed_at_corners_of_several_numbers():
    assert surveyed(TIME) == []  # both ends of one number are probed anyway
    probes = surveyed(TIME, SLIDERS)
    assert len(probes) == 8
    assert all(set(probe.inputs["sliders"]) <= {-1.0, 3.0} for probe in probes)


def test_a_camera_that_changes_nothing_is_not_surveyed():
    assert surveyed(VIEW, depends_on={"view": False}) == []
    assert len(surveyed(VIEW, EYE, depends_on={"view": False})) == 27


def test_a_limit_leaves_the_cameras_inside_and_far_away():
    labels = [probe.label for probe in surveyed(VIEW, limit=3)]
    assert labels == ["from the middle", "from the centre of a Gaussian", "from 20 diagonals"]


def test_probes_are_the_same_every_time():
    pairs = zip(surveyed(VIEW, TIME, SLIDERS), surveyed(VIEW, TIME, SLIDERS), strict=True)
    for a, b in pairs:
        assert a.label == b.label
        for name in a.inputs:
            np.testing.assert_array_equal(a.inputs[name], b.inputs[name])


ECHO = model(
    "echo (float[4,4] view, float[3] eye, float[7,10] table) => "
    "(float[7,10] rows, int32[1] count, float[4,4] seen, float[3] stood) "
    "<int32[1] four = {4}> { rows = Neg (table) count = Identity (four) "
    "seen = Identity (view) stood = Identity (eye) }"
)


def echoed(table, tmp_path, order="column", **probe):
    """Run the model above twice: for a base probe, and for the probe of a test."""
    path = save(tmp_path / "echo.onnx", ECHO)
    view = look_at(np.array([2.0, 3.0, 4.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    inputs = {"view": as_tensor(view, order), "eye": np.float32([9, 9, 9]), "table": -table}
    probes = [Probe(label="zeros", inputs=inputs), Probe(label="base", inputs=inputs)]
    probes.append(Probe(label="survey", inputs=inputs, extra=True, **probe))
    outputs = ["rows", "count", "seen", "stood"]
    with execute(path, outputs, probes, Limits(), rows="rows", count="count") as execution:
        assert execution.fault is None
        sample = execution.samples[execution.runs[2].sample]
        outputs = {name: np.array(value) for name, value in sample.outputs.items()}
        return execution.runs[2], sample, outputs, view


@pytest.mark.parametrize("order", ["column", "row"])
def test_the_sandbox_moves_a_camera_to_the_first_gaussian_that_is_drawn(order, tmp_path):
    table = np.random.default_rng(1).normal(size=(7, 10)).astype(np.float32)
    table[:, 3] = [0, 0.001, np.nan, 0.5, 1, 0, 0]
    placement = CameraPlacement(rows="rows", order=order, view="view", position="eye")
    run, _, outputs, view = echoed(table, tmp_path, order, placement=placement)
    np.testing.assert_array_equal(run.center, table[3, :3])
    np.testing.assert_array_equal(outputs["stood"], table[3, :3])
    actual = as_tensor(outputs["seen"], order)
    np.testing.assert_allclose(actual[:3, :3], view[:3, :3], atol=1e-6)
    np.testing.assert_allclose(eye_of(actual), table[3, :3], atol=1e-5)


def test_a_camera_stays_where_no_gaussian_is_drawn(tmp_path):
    placement = CameraPlacement(rows="rows", order="column", view="view", position="eye")
    table = np.zeros((7, 10), np.float32)
    run, _, outputs, _ = echoed(table, tmp_path, placement=placement)
    assert run.center == ()
    np.testing.assert_array_equal(outputs["stood"], [9, 9, 9])


def test_cameras_above_and_below_look_along_up_and_those_at_rims_stand_or_look_there():
    probes = {probe.label: probe for probe in surveyed(VIEW)}
    center, half = (LOW + HIGH) / 2, (HIGH - LOW) / 2
    views = {label: as_tensor(probe.inputs["view"], "column") for label, probe in probes.items()}
    up = np.array([0.0, -1.0, 0.0])
    np.testing.assert_allclose(views["from above"][2, :3], -up, atol=1e-6)
    np.testing.assert_allclose(views["from below"][2, :3], up, atol=1e-6)
    offset = np.abs(eye_of(views["from the rim"]) - center) / half
    assert sorted(offset.round(4)) == [0.0, 0.0, 1.0]
    seen = views["with the scene at the picture's rim"] @ [*center, 1.0]
    assert np.arctan2(abs(seen[0]), seen[2]) == pytest.approx(np.deg2rad(30), abs=1e-5)


def test_few_numbers_take_every_combination_of_their_ends():
    more = Input(name="eye", role="control", range=(0.0, 1.0), shape=(3,))
    probes = surveyed(VIEW, TIME, more)[7:]
    corners = {(*probe.inputs["time"], *probe.inputs["eye"]) for probe in probes}
    assert len(corners) == 16


@pytest.mark.parametrize("seed", range(4))
def test_survey_probe_keeps_rows_that_look_faulty_alone(seed, tmp_path):
    table = valid_rows(seed)
    _, sample, outputs, _ = echoed(table, tmp_path, survey=True)
    assert outputs == {}
    assert sample.not_finite == ()
    assert (sample.survey.count, sample.survey.capacity) == (4, 7)
    table[5, 3] = 0.5  # behind the count
    _, _, outputs, _ = echoed(table, tmp_path, survey=True)
    np.testing.assert_array_equal(outputs["rows"], table)


def valid_rows(seed):
    """Return seven packed rows, of which the last three are padding."""
    rng = np.random.default_rng(seed)
    table = np.zeros((7, 10), np.float32)
    table[:4, :3], table[:4, 3] = rng.normal(size=(4, 3)), rng.uniform(0.1, 1, 4)
    root = rng.normal(size=(4, 3, 3))
    full = root @ root.transpose(0, 2, 1)
    table[:4, 4:] = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return table


def test_a_survey_probe_notes_which_output_is_not_finite_in_any_row(tmp_path):
    table = np.zeros((7, 10), np.float32)
    table[6, 9] = np.inf  # behind the count
    _, sample, _, _ = echoed(table, tmp_path, survey=True)
    assert sample.not_finite == ("rows",)

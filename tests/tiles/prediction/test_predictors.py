"""Predictors continue paths that are known, and models are held to their contract."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures.corpus import find
from gsgen.contract.errors import InputUnreadable, UnknownName
from gsgen.contract.manifest import FutureOutput, TrajectoryManifest, UncertaintyOutput
from gsgen.contract.spec.geometry import (
    quaternion_product,
    rotation_matrix,
    rotation_quaternion,
    rotation_vector,
)
from gsgen.tiles.prediction.poses import Pose, interpolate, matrix_quaternion
from gsgen.tiles.prediction.predictor import ConstantVelocity
from gsgen.tiles.prediction.predictors import predictor_maker
from support.commands import gsgen_here
from support.tiles.journeys import (
    PATH_HEADER,
    TRACE_HEADER,
    journeys,
    networks,
    write_rows,
    write_town,
)


def steady_path(rng: np.random.Generator, times: np.ndarray) -> list[Pose]:
    """A path at constant velocity and rotation rate."""
    start, velocity, rate = rng.normal(size=(3, 3))
    first = rotation_quaternion(rng.normal(size=3))
    return [
        Pose(
            float(t), start + velocity * t, quaternion_product(rotation_quaternion(rate * t), first)
        )
        for t in times
    ]


def assert_same_rotation(first: np.ndarray, second: np.ndarray, tolerance: float = 1e-9) -> None:
    assert abs(first @ second) == pytest.approx(1, abs=tolerance)


def test_rotations_are_those_of_their_matrices() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        first, second = (rotation_quaternion(rng.normal(size=3)) for _ in range(2))
        product = rotation_matrix(quaternion_product(first, second)[None])[0]
        matrices = rotation_matrix(np.stack([first, second]))
        np.testing.assert_allclose(product, matrices[0] @ matrices[1], atol=1e-12)
        assert_same_rotation(matrix_quaternion(matrices[0]), first)
        for sign in (1, -1):
            assert_same_rotation(rotation_quaternion(rotation_vector(sign * first)), first)
        assert np.linalg.norm(rotation_vector(first)) <= np.pi + 1e-12
    assert rotation_vector(np.array([1.0, 0, 0, 0])).tolist() == [0, 0, 0]


def test_poses_between_two_lie_on_the_steady_path() -> None:
    rng = np.random.default_rng(1)
    path = steady_path(rng, np.linspace(0, 1, 5))
    for time in (0.1, 0.3, 0.77):
        pose = interpolate(path[::2], time)
        rng_again = np.random.default_rng(1)
        expected = steady_path(rng_again, np.array([time]))[0]
        np.testing.assert_allclose(pose.position, expected.position, atol=1e-12)
        assert_same_rotation(pose.quaternion, expected.quaternion)
    assert interpolate(path, -1.0).position.tolist() == path[0].position.tolist()
    assert interpolate(path, 9.0).position.tolist() == path[-1].position.tolist()


@pytest.mark.parametrize("flip", [False, True])
def test_constant_velocity_continues_a_steady_path_whose_turns_fade(flip: bool) -> None:
    """It has turned as a steady path has after τ (1 − exp(−s / τ)) seconds."""
    times = np.arange(0, 1.2, 0.1)
    path = steady_path(np.random.default_rng(2), times)
    predictor = ConstantVelocity()
    for index, pose in enumerate(path):
        sign = -1 if flip and index % 2 else 1
        predictor.observe(replace(pose, quaternion=sign * pose.quaternion))
    ahead = [0.25, 1.0, 2.0]
    prediction = predictor.predict(ahead)
    expected = steady_path(np.random.default_rng(2), times[-1] + np.array(ahead))
    faded = [0.4 * (1 - np.exp(-seconds / 0.4)) for seconds in ahead]
    turned = steady_path(np.random.default_rng(2), times[-1] + np.array(faded))
    for predicted, pose, turn in zip(prediction, expected, turned, strict=True):
        assert predicted.time == pytest.approx(pose.time)
        np.testing.assert_allclose(predicted.position, pose.position, atol=1e-9)
        assert_same_rotation(predicted.quaternion, turn.quaternion)


def test_constant_velocity_predicts_nothing_from_one_pose() -> None:
    predictor = ConstantVelocity()
    assert predictor.predict([1.0]) == []
    predictor.observe(steady_path(np.random.default_rng(3), np.array([0.0]))[0])
    assert predictor.predict([1.0]) == []


def model_file(folder: Path, *, axis_angle: bool = False) -> Path:
    """The straight-on example, or the same for axis-angle states with a covariance."""
    spec = find("trajectory").draw()
    path = folder / "model.onnx"
    if axis_angle:
        manifest = spec.manifest
        assert isinstance(manifest, TrajectoryManifest)
        uncertainty = np.zeros((3, 21), np.float32)
        uncertainty[:, [0, 6, 11, 15, 18, 20]] = [0.04, 0.09, 0.16, 0.01, 0.01, 0.25]
        spec = replace(
            spec,
            inputs="float[4,6] past",
            outputs="float[3,6] future, float[3,21] sigma",
            body="future = MatMul (steps, past) sigma = Identity (doubt)",
            weights={"steps": spec.weights["steps"], "doubt": uncertainty},
            manifest=replace(
                manifest,
                inputs=(replace(manifest.inputs[0], shape=(4, 6), range=None),),
                outputs=replace(
                    manifest.outputs,
                    future=FutureOutput("future", 3, "position+axis-angle"),
                    uncertainty=UncertaintyOutput("sigma", "covariance-upper"),
                ),
            ),
        )
    spec.write(path)
    return path


@pytest.mark.parametrize("axis_angle", [False, True])
@pytest.mark.parametrize("far", [0.0, 4e6])
def test_a_model_continues_a_path_between_its_steps(
    tmp_path: Path, axis_angle: bool, far: float
) -> None:
    predictor = predictor_maker(str(model_file(tmp_path, axis_angle=axis_angle)))()
    assert predictor.reach == pytest.approx(0.3)
    velocity, rate = np.array([1.0, 2, -0.5]), np.array([0.0, 0, 0.4])
    for time in np.arange(0, 1, 0.04):
        quaternion = rotation_quaternion(rate * time)
        predictor.observe(Pose(float(time), far + velocity * time, quaternion))
    last = time
    prediction = predictor.predict([0.05, 0.2, 0.3])
    for predicted, ahead in zip(prediction, (0.05, 0.2, 0.3), strict=True):
        expected = far + velocity * (last + ahead)
        np.testing.assert_allclose(predicted.position, expected, atol=1e-3)
        turned = rotation_quaternion(rate * (last + ahead))
        assert_same_rotation(predicted.quaternion, turned, 1e-4)


def test_name_or_file_that_is_not_a_predictor_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="constant-velocity"):
        predictor_maker("constant-speed")
    generator = tmp_path / "generator.onnx"
    find("drift").draw().write(generator)
    with pytest.raises(InputUnreadable, match="expected kind trajectory-predictor"):
        predictor_maker(str(generator))
    with pytest.raises(InputUnreadable):
        predictor_maker(str(tmp_path / "missing.onnx"))
    spec = find("states_of_another_size").draw()
    spec.write(generator)
    with pytest.raises(InputUnreadable, match=r"expected \[T, 6\]"):
        predictor_maker(str(generator))


def test_outputs_that_are_not_finite_are_no_prediction(tmp_path: Path) -> None:
    predictor = predictor_maker(str(model_file(tmp_path, axis_angle=False)))()
    for time in np.arange(0, 1, 0.04):
        far = np.full(3, 3.4e38 * (-1) ** round(time / 0.04))  # speeds exceed float32
        predictor.observe(Pose(float(time), far / 2, np.array([1.0, 0, 0, 0])))
    with pytest.raises(InputUnreadable, match="are not finite"):
        predictor.predict([0.1])


def test_the_command_takes_a_model(tmp_path: Path) -> None:
    tileset = write_town(tmp_path, depth=2)
    path = write_rows(tmp_path / "path.csv", PATH_HEADER, journeys()["orbit"][:50])
    trace = write_rows(tmp_path / "trace.csv", TRACE_HEADER, networks()["20"])
    options = ["--path", path, "--network", trace, "--policy", "predictive", "--predictor"]
    result = gsgen_here("tiles", "simulate", tileset, *options, model_file(tmp_path))
    assert result.code == 0, result.err
    assert "predictive" in result.out
    result = gsgen_here("tiles", "simulate", tileset, *options, tileset)
    assert result.code == 4
    assert "tileset.json" in result.err

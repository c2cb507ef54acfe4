import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gsgen.contract.spec import geometry
from gsgen.sdk import math


@pytest.fixture
def quaternions() -> np.ndarray:
    rng = np.random.default_rng(2)
    result = rng.normal(size=(500, 4)) * np.exp(rng.normal(0, 4, (500, 1)))
    return result.astype(np.float32)


def test_rotation_matrices_are_those_of_the_oracle(quaternions: np.ndarray) -> None:
    actual = math.quaternion_to_matrix(torch.from_numpy(quaternions)).numpy()
    np.testing.assert_allclose(actual, geometry.rotation_matrix(quaternions), atol=2e-6)


def test_quaternions_of_matrices_are_those_of_scipy_up_to_their_sign() -> None:
    """Random rotations, and half turns about each axis, where three of the four forms divide by 0."""
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    rotations = Rotation.concatenate(
        [Rotation.random(300, rng=4), half_turns, Rotation.identity(1)]
    )
    matrices = torch.from_numpy(rotations.as_matrix().astype(np.float32))
    actual = math.matrix_to_quaternion(matrices).numpy()
    expected = rotations.as_quat(scalar_first=True)
    assert np.abs(np.abs((actual * expected).sum(axis=1)) - 1).max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(actual, axis=1), 1, atol=1e-6)


def test_normalising_zero_gives_zero_and_a_finite_gradient() -> None:
    zero = torch.zeros(2, 3, requires_grad=True)
    result = math.safe_normalize(zero)
    result.sum().backward()
    assert result.tolist() == [[0, 0, 0], [0, 0, 0]]
    assert zero.grad is not None
    assert torch.isfinite(zero.grad).all()


@pytest.mark.parametrize("length", [1e-9, 1e-3, 1.0, 1e6, 1e18])
def test_normalising_keeps_the_direction_at_any_length(length: float) -> None:
    result = math.safe_normalize(torch.tensor([[3.0, 0.0, 4.0]]) * length)
    np.testing.assert_allclose(result.numpy(), [[0.6, 0.0, 0.8]], rtol=1e-5)


@pytest.mark.parametrize("length", [0.0, 1e-9, 1e-6, 1e-3, 0.5, np.pi, 6.0, 100.0])
def test_rotation_vectors_turn_as_scipy_s_do(length: float) -> None:
    axis = np.random.default_rng(5).normal(size=(50, 3))
    vectors = length * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    actual = math.axis_angle_to_matrix(torch.from_numpy(vectors.astype(np.float32))).numpy()
    expected = Rotation.from_rotvec(vectors.astype(np.float32)).as_matrix()
    np.testing.assert_allclose(actual, expected, atol=3e-7 * max(length, 3))


def test_zero_rotation_has_a_finite_gradient() -> None:
    zero = torch.zeros(1, 3, requires_grad=True)
    math.axis_angle_to_matrix(zero)[0, 1, 2].backward()
    assert zero.grad is not None
    np.testing.assert_allclose(zero.grad.numpy(), [[-1, 0, 0]])


def test_products_of_quaternions_turn_one_after_the_other() -> None:
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(2, 40, 4)).astype(np.float32)
    actual = math.quaternion_multiply(torch.from_numpy(a), torch.from_numpy(b)).numpy()
    expected = geometry.rotation_matrix(a) @ geometry.rotation_matrix(b)
    np.testing.assert_allclose(geometry.rotation_matrix(actual), expected, atol=2e-6)

"""Scales and rotations of covariances, beside the eigenvalues of LAPACK."""

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper, symmetric
from gsgen.formats.shared import principal_axes
from gsgen.formats.shared.principal_axes import scales_and_quaternions


def assert_decomposed(covariance: np.ndarray) -> None:
    """Rebuild covariances from scales and rotations, and compare the eigenvalues with LAPACK's."""
    scales, quaternions = scales_and_quaternions(covariance)
    expected = np.linalg.eigvalsh(symmetric(covariance))
    largest = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(scales**2 - np.maximum(expected, 0)) <= 1e-14 * largest + 1e-300).all()
    again = covariance_upper(scales, quaternions.astype(np.float64))
    negative_eigenvalue = np.maximum(
        -expected.min(axis=1, keepdims=True), 0
    )  # the negative eigenvalues
    assert (np.abs(again - covariance) <= 5e-7 * largest + 2 * negative_eigenvalue).all()
    assert (np.diff(scales, axis=1) >= 0).all()
    assert (quaternions[:, :1] >= np.abs(quaternions)).all()
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("span", [0.0, 2.0, 5.0])
def test_random_covariances_round_trip(span: float) -> None:
    """Axes differ by up to ``span`` decades."""
    rng = np.random.default_rng(int(span))
    scale = 10 ** rng.uniform(-span, 0, (500, 3))
    covariance = covariance_upper(scale, rng.normal(size=(500, 4)))
    assert_decomposed(covariance)
    scales, _ = scales_and_quaternions(covariance)
    np.testing.assert_allclose(scales, np.sort(scale, axis=1), rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("size", [1e-30, 1e-12, 1.0, 1e12, 1e30])
def test_degenerate_matrices_round_trip_at_every_scale(size: float) -> None:
    rng = np.random.default_rng(3)
    upper = np.array(
        [
            [0, 0, 0, 0, 0, 0],
            [1, 0, 0, 1, 0, 1],
            [4, 0, 0, 0, 0, 0],
            [1, 1, 1, 1, 1, 1],  # rank 1
            [2, 1, 1, 2, 1, 2],  # two equal eigenvalues
            [1, 1e-9, 0, 1, 1e-9, 1],
            [1, -1e-20, 1e-20, 1e-20, 0, 1e-30],
            [3, 2, 0, 1e-3, 0, 5],  # a negative eigenvalue
        ],
        np.float64,
    )
    nearly_equal = np.array([1, 0, 0, 1, 0, 1]) + 1e-13 * rng.normal(size=(200, 6))
    assert_decomposed(size * np.concatenate([upper, nearly_equal]))


def test_random_symmetric_matrices_are_decomposed() -> None:
    assert_decomposed(np.random.default_rng(5).normal(size=(2000, 6)))


def test_a_row_does_not_depend_on_its_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    covariance = covariance_upper(rng.uniform(0.01, 2, (101, 3)), rng.normal(size=(101, 4)))
    whole = scales_and_quaternions(covariance.astype(np.float32))
    monkeypatch.setattr(principal_axes, "_CHUNK_ROWS", 7)
    in_parts = scales_and_quaternions(covariance.astype(np.float32))
    for first, second in zip(whole, in_parts, strict=True):
        np.testing.assert_array_equal(first, second)


def test_half_turns_of_the_source_change_nothing() -> None:
    """Splats whose quaternions differ by signs of axes have one covariance, and one result."""
    rng = np.random.default_rng(2)
    scale = np.sort(rng.uniform(0.01, 2, (200, 3)), axis=1)
    turn = rng.normal(size=(200, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    _, result = scales_and_quaternions(covariance_upper(scale, turn))
    w, x, y, z = turn.T
    same = np.stack([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])
    nearest = np.abs((same * result.T).sum(axis=1)).max(axis=0)
    np.testing.assert_allclose(nearest, 1, atol=1e-6)

import math

import numpy as np
import pytest

from gsgen.contract.spec.spherical_harmonics import (
    basis,
    coefficients,
    degree_of,
    evaluate,
    largest_sum,
)


def directions(count, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def quadrature():
    """Points and weights that integrate polynomials of degree 6 over the sphere exactly."""
    z, weight = np.polynomial.legendre.leggauss(8)
    turns = 2 * np.pi * np.arange(16) / 16
    z, turn = (grid.ravel() for grid in np.meshgrid(z, turns, indexing="ij"))
    radius = np.sqrt(1 - z * z)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
    return points, np.repeat(weight, 16) * 2 * np.pi / 16


def legendre(degree, order, z):
    """The associated Legendre function with the Condon–Shortley phase, by Rodrigues' formula."""
    polynomial = np.polynomial.Polynomial([-1, 0, 1]) ** degree
    derived = polynomial.deriv(degree + order) / (2**degree * math.factorial(degree))
    return (-1) ** order * (1 - z * z) ** (order / 2) * derived(z)


def harmonic(degree, order, points):
    """The real spherical harmonic of the textbooks, from angles."""
    x, y, z = points.T
    m, turn = abs(order), np.arctan2(y, x)
    ratio = math.factorial(degree - m) / math.factorial(degree + m)
    norm = math.sqrt((2 * degree + 1) / (4 * math.pi) * ratio)
    wave = 1.0 if m == 0 else math.sqrt(2) * (np.cos if order > 0 else np.sin)(m * turn)
    return norm * legendre(degree, m, z) * wave


def test_the_basis_is_orthonormal_on_the_sphere():
    points, weights = quadrature()
    result = basis(points)
    np.testing.assert_allclose(result.T * weights @ result, np.eye(16), atol=1e-12)


def test_the_basis_is_that_of_the_textbooks_with_the_condon_shortley_phase():
    points = directions(200)
    orders = [(degree, order) for degree in range(4) for order in range(-degree, degree + 1)]
    expected = np.stack([harmonic(*order, points) for order in orders], axis=1)
    np.testing.assert_allclose(basis(points), expected, atol=1e-12)


def test_degree_one_is_minus_y_plus_z_minus_x():
    c1 = 0.4886025119029199  # the constant in the code of Kerbl et al. 2023
    np.testing.assert_allclose(
        basis(np.eye(3), 1)[:, 1:], c1 * np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]])
    )


@pytest.mark.parametrize("degree", range(4))
def test_a_lower_degree_is_a_prefix_of_the_basis(degree):
    points = directions(5)
    result = basis(points, degree)
    assert result.shape == (5, coefficients(degree))
    assert result.dtype == np.float64
    np.testing.assert_array_equal(result, basis(points)[:, : coefficients(degree)])


def test_the_constant_term_is_the_same_colour_from_everywhere():
    sh = np.array([[[1.0, 0.0, -1.0]]])
    color = evaluate(sh, directions(7))
    assert color.shape == (1, 7, 3)
    np.testing.assert_allclose(color[0], [[0.5 + 0.28209479177387814, 0.5, 0.5 - 0.28209479]] * 7)


def test_colour_is_clamped_below_at_zero_and_not_above():
    color = evaluate(np.array([[[10.0, -10.0, 0.0]]]), directions(1))[0, 0]
    assert color[0] > 3
    assert color[1] == 0


def test_colour_is_the_sum_of_basis_functions_plus_one_half():
    rng = np.random.default_rng(1)
    sh, points = rng.normal(size=(3, 16, 3)), directions(4)
    expected = [[[0.5 + basis(d) @ entry[:, c] for c in range(3)] for d in points] for entry in sh]
    np.testing.assert_allclose(evaluate(sh, points), np.maximum(expected, 0))


@pytest.mark.parametrize(("count", "degree"), [(1, 0), (4, 1), (9, 2), (16, 3)])
def test_a_count_of_coefficients_has_a_degree(count, degree):
    assert degree_of(count) == degree
    assert coefficients(degree) == count


@pytest.mark.parametrize("count", [0, 2, 3, 15, 17, 25, -1])
def test_other_counts_have_no_degree(count):
    with pytest.raises(ValueError, match=rf"^{count} is not a number of SH .*\(1, 4, 9, 16\)$"):
        degree_of(count)


@pytest.mark.parametrize("count", [0, 1, 37])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_the_largest_sum_is_that_of_every_direction_and_channel(count, degree):
    rng = np.random.default_rng(count + degree)
    directions = rng.normal(size=(9, 3))
    weights = basis(directions / np.linalg.norm(directions, axis=1)[:, None], degree)
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3))
    expected = np.abs(np.einsum("dk,nkc->ndc", weights, sh)).max(axis=(1, 2), initial=0)
    np.testing.assert_allclose(largest_sum(weights, sh), expected, rtol=1e-12)


def test_a_sum_without_a_number_has_no_size():
    sh = np.zeros((2, 4, 3))
    sh[1, 2, 0] = np.nan
    sizes = largest_sum(basis(np.eye(3), 1), sh)
    assert sizes[0] == 0
    assert np.isnan(sizes[1])

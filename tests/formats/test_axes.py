import itertools

import numpy as np
import pytest

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.contract.spec.spherical_harmonics import basis, evaluate
from gsgen.formats.shared.axes import RDF_LUF, RDF_RUB, flip, sh_signs
from gsgen.formats.shared.harmonics import rotate_sh, sh_basis
from support.splat_files import FIELDS, scene

SIGNS = list(itertools.product((1, -1), repeat=3))


def directions(count: int = 50) -> np.ndarray:
    result = np.random.default_rng(0).standard_normal((count, 3))
    return result / np.linalg.norm(result, axis=1, keepdims=True)


@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_harmonics_change_sign_as_their_functions_do(degree, signs):
    reference = sh_basis(directions() * signs, degree)
    here = sh_basis(directions(), degree)
    np.testing.assert_allclose(reference, here * sh_signs(degree, signs), atol=1e-12)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_harmonics_are_those_of_the_contract(degree):
    np.testing.assert_allclose(
        sh_basis(directions(), degree), basis(directions(), degree), atol=1e-12
    )


def test_the_harmonics_of_degree_4_are_orthonormal():
    """On a grid that integrates polynomials of degree 8 exactly."""
    z, weight = np.polynomial.legendre.leggauss(9)
    around = np.arange(18) * 2 * np.pi / 18
    ring = np.sqrt(1 - z**2)[:, None]
    points = np.stack(
        [ring * np.cos(around), ring * np.sin(around), z[:, None] + 0 * around], axis=-1
    )
    values = sh_basis(points.reshape(-1, 3), 4)
    weights = np.repeat(weight, 18) * 2 * np.pi / 18
    np.testing.assert_allclose(values.T @ (values * weights[:, None]), np.eye(25), atol=1e-12)


@pytest.mark.parametrize("signs", [RDF_RUB, RDF_LUF])
def test_flipping_twice_is_the_identity(signs):
    splats = scene(20, 4)
    back = flip(flip(splats, signs), signs)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(back, name), getattr(splats, name))


@pytest.mark.parametrize("signs", [RDF_RUB, RDF_LUF])
def test_a_flip_turns_ellipsoids_and_colours(signs):
    splats = scene(20, 3)
    flipped = flip(splats, signs)
    mirror = np.diag(signs)
    shapes = [
        rotation_matrix(scene_splats.rotation) * np.exp(scene_splats.log_scale)[:, None]
        for scene_splats in (splats, flipped)
    ]
    here, reference = (shape @ shape.swapaxes(1, 2) for shape in shapes)
    np.testing.assert_allclose(reference, mirror @ here @ mirror, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(
        evaluate(flipped.sh, directions() * signs), evaluate(splats.sh, directions()), atol=1e-6
    )


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_turned_harmonics_show_the_same_colours_along_turned_directions(degree):
    turn = rotation_matrix(np.array([[0.3, -0.5, 0.7, 0.2]]))[0]
    sh = scene(10, degree).sh
    turned = rotate_sh(sh, turn)
    here = np.einsum("dk,nkc->ndc", sh_basis(directions(), degree), sh)
    reference = np.einsum("dk,nkc->ndc", sh_basis(directions() @ turn.T, degree), turned)
    np.testing.assert_allclose(reference, here, atol=1e-6)

import numpy as np
import pytest

from gsgen.contract.spec.geometry import (
    COVARIANCE_INDEX,
    covariance_upper,
    look_at,
    perspective,
    rotation_matrix,
    smallest_eigenvalue,
    symmetric,
)

RNG = np.random.default_rng(7)
QUATERNIONS = RNG.normal(size=(50, 4))


def product(a, b):
    """Hamilton's product of quaternions (w, x, y, z)."""
    w = a[0] * b[0] - a[1:] @ b[1:]
    return np.array([w, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def upper(matrices):
    return matrices[:, COVARIANCE_INDEX[0], COVARIANCE_INDEX[1]]


def random_symmetric(n):
    half = np.random.default_rng(3).normal(size=(n, 3, 3))
    return half + half.transpose(0, 2, 1)


def test_rotations_are_orthonormal_and_keep_handedness():
    result = rotation_matrix(QUATERNIONS)
    identity = np.broadcast_to(np.eye(3), result.shape)
    np.testing.assert_allclose(result @ result.transpose(0, 2, 1), identity, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(result), 1)


def test_a_rotation_turns_vectors_as_its_quaternion_does():
    for quaternion, result in zip(QUATERNIONS, rotation_matrix(QUATERNIONS), strict=True):
        unit = quaternion / np.linalg.norm(quaternion)
        back = unit * [1, -1, -1, -1]
        for vector in np.eye(3):
            expected = product(product(unit, np.array([0, *vector])), back)[1:]
            np.testing.assert_allclose(result @ vector, expected, atol=1e-14)


def test_a_quaternion_has_its_real_part_first():
    half = np.sqrt(0.5)
    quarter_turn_about_z = rotation_matrix(np.array([[half, 0, 0, half]]))[0]
    np.testing.assert_allclose(quarter_turn_about_z @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_a_zero_quaternion_is_the_identity_and_nan_stays_nan():
    result = rotation_matrix(np.array([[0, 0, 0, 0], [1, np.nan, 0, 0], [5, 0, 0, 0]]))
    np.testing.assert_array_equal(result[[0, 2]], [np.eye(3)] * 2)
    assert np.isnan(result[1]).all()


def test_a_covariance_is_r_s_s_transposed_r_transposed():
    scales = RNG.uniform(0, 3, (50, 3))
    result = covariance_upper(scales, QUATERNIONS)
    for row, scale, quaternion in zip(result, scales, QUATERNIONS, strict=True):
        r, s = rotation_matrix(quaternion[None])[0], np.diag(scale)
        full = r @ s @ s.T @ r.T
        expected = [full[0, 0], full[0, 1], full[0, 2], full[1, 1], full[1, 2], full[2, 2]]
        np.testing.assert_allclose(row, expected, atol=1e-12)


def test_an_upper_triangle_is_spread_to_both_sides():
    assert symmetric(np.arange(6.0)[None])[0].tolist() == [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
    full = random_symmetric(20)
    np.testing.assert_array_equal(symmetric(upper(full)), full)


def test_the_smallest_eigenvalue_is_that_of_lapack():
    full = random_symmetric(500)
    expected = np.linalg.eigvalsh(full)[:, 0]
    np.testing.assert_allclose(smallest_eigenvalue(upper(full)), expected, atol=1e-7)


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e6, 1e30])
@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        (np.zeros((3, 3)), 0),
        (np.eye(3), 1),
        (-2 * np.eye(3), -2),
        (np.diag([1.0, 1.0, 0.0]), 0),
        (np.diag([5.0, 2.0, 2.0]), 2),
        (np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]), 0),
        (-np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]), -14),
        (np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 0]]), -1),
        (np.ones((3, 3)), 0),
    ],
)
def test_the_smallest_eigenvalue_of_degenerate_matrices_is_right(matrix, expected, scale):
    result = smallest_eigenvalue(upper(scale * matrix[None]))[0]
    assert result == pytest.approx(scale * expected, abs=1e-7 * scale * np.abs(matrix).sum())


def test_the_smallest_eigenvalue_of_nan_is_nan():
    assert np.isnan(smallest_eigenvalue(np.array([[np.nan, 0, 0, 1, 0, 1]])))[0]


EYE, TARGET, UP = np.array([1.0, 2, 3]), np.array([4.0, -1, 5]), np.array([0.0, 0, 2])


def to_view_space(view, point):
    return (view @ [*point, 1])[:3]


def test_the_view_is_a_rigid_motion_that_puts_the_eye_at_the_origin():
    view = look_at(EYE, TARGET, UP)
    np.testing.assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-15)
    assert np.linalg.det(view[:3, :3]) == pytest.approx(1)
    np.testing.assert_allclose(to_view_space(view, EYE), 0, atol=1e-15)
    np.testing.assert_array_equal(view[3], [0, 0, 0, 1])


def test_the_camera_looks_along_plus_z_with_y_down_and_x_right():
    view = look_at(np.zeros(3), np.array([0.0, 5, 0]), np.array([0.0, 0, 1]))
    np.testing.assert_allclose(to_view_space(view, [0, 5, 0]), [0, 0, 5], atol=1e-15)
    np.testing.assert_allclose(to_view_space(view, [0, 5, 1]), [0, -1, 5], atol=1e-15)  # above
    np.testing.assert_allclose(
        to_view_space(view, [1, 5, 0]), [1, 0, 5], atol=1e-15
    )  # to the right


@pytest.mark.parametrize("up", [*np.eye(3), np.ones(3), -np.ones(3), 1e-12 * np.ones(3)])
def test_looking_along_up_gives_a_finite_camera(up):
    for sign in (1, -1):
        view = look_at(EYE, EYE + sign * up / np.linalg.norm(up), up)
        np.testing.assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view[:3, :3]) == pytest.approx(1)


def test_the_length_of_up_does_not_matter():
    np.testing.assert_allclose(
        look_at(EYE, TARGET, 1e-12 * UP), look_at(EYE, TARGET, 1e12 * UP), atol=1e-14
    )


NEAR, FAR = 0.5, 20.0


def clip(point, fov=1.0, aspect=2.0):
    x, y, z, w = perspective(fov, aspect, NEAR, FAR) @ [*point, 1]
    return np.array([x, y, z]) / w


def test_the_target_projects_to_the_image_centre():
    camera = to_view_space(look_at(EYE, TARGET, UP), TARGET)
    np.testing.assert_allclose(clip(camera)[:2], 0, atol=1e-15)


@pytest.mark.parametrize(("distance", "depth"), [(NEAR, 0), (FAR, 1)])
def test_depth_goes_from_zero_at_near_to_one_at_far(distance, depth):
    assert clip([0, 0, distance])[2] == pytest.approx(depth, abs=1e-15)


def test_clip_space_has_y_up_and_x_right():
    view = look_at(EYE, TARGET, UP)
    above = clip(to_view_space(view, TARGET + UP))
    assert above[1] > 0
    assert clip([1, 0, 5])[0] > 0


def test_the_field_of_view_is_horizontal_and_aspect_is_width_over_height():
    edge = 4 * np.tan(0.5)
    np.testing.assert_allclose(clip([edge, 0, 4])[:2], [1, 0], atol=1e-15)
    np.testing.assert_allclose(clip([0, -edge / 2, 4])[:2], [0, 1], atol=1e-15)

"""Merging beside naive float64 loops that share no code with it."""

import math

import numpy as np
import pytest

from gsgen.contract.spec.geometry import rotation_matrix, symmetric
from gsgen.formats.merging.mixture import Mixture, concatenate, surface_area
from gsgen.formats.merging.moments import MAX_OPACITY, ellipsoids, merge_clusters, squared_shift
from support.tiles.tile_scenes import mixture

P = 1.6075


def area_oracle(covariance: np.ndarray) -> float:
    a, b, c = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0))
    return 4 * math.pi * (((a * b) ** P + (a * c) ** P + (b * c) ** P) / 3) ** (1 / P)


def merge_oracle(
    mixture: Mixture, rows: range, spread: float, widen: float
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """The equations, one Gaussian after the other."""
    full = symmetric(mixture.covariance)
    weights = [mixture.opacity[i] * area_oracle(full[i]) for i in rows]
    total = math.fsum(weights)
    mean = sum(w * mixture.mean[i] for w, i in zip(weights, rows, strict=True)) / total
    covariance = np.zeros((3, 3))
    sh = np.zeros((4, 3))
    for weight, i in zip(weights, rows, strict=True):
        offset = mixture.mean[i] - mean
        covariance += weight * (full[i] + spread * np.outer(offset, offset)) / total
        sh += weight * mixture.sh[i] / total
    covariance *= widen**2
    return mean, covariance, min(total / area_oracle(covariance), MAX_OPACITY), sh


@pytest.mark.parametrize("seed", range(4))
def test_the_shift_is_the_mean_square_of_distances_by_mass(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 60))
    members = mixture(rng, count)
    starts = np.flatnonzero(np.concatenate([[True], rng.random(count - 1) < 0.3]))
    merged = merge_clusters(members, starts)
    full = symmetric(members.covariance)
    weights = [members.opacity[i] * area_oracle(full[i]) for i in range(count)]
    cluster = np.searchsorted(starts, np.arange(count), side="right") - 1
    distances = [math.dist(members.mean[i], merged.mean[cluster[i]]) for i in range(count)]
    total = math.fsum(w * d**2 for w, d in zip(weights, distances, strict=True))
    assert squared_shift(members, starts) == pytest.approx(total / math.fsum(weights), rel=1e-6)
    assert squared_shift(members, np.arange(count)) == pytest.approx(0, abs=1e-20)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("origin", [0.0, 1e6])
@pytest.mark.parametrize(("spread", "widen"), [(1.0, 1.0), (2.0, 1.1)])
def test_clusters_have_the_moments_of_their_members(seed, origin, spread, widen):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 60))
    members = mixture(rng, count, origin=origin)
    starts = np.flatnonzero(np.concatenate([[True], rng.random(count - 1) < 0.3]))
    merged = merge_clusters(members, starts, spread=spread, widen=widen)
    limits = [*starts.tolist(), count]
    assert len(merged) == len(starts)
    for index in range(len(starts)):
        rows = range(limits[index], limits[index + 1])
        np.testing.assert_array_equal(merged.code[index], members.code[rows[0]])
        if len(rows) == 1:
            continue
        mean, covariance, opacity, sh = merge_oracle(members, rows, spread, widen)
        np.testing.assert_allclose(merged.mean[index], mean, rtol=0, atol=1e-9 + origin * 1e-15)
        # Offsets of members that are a million away have nine digits behind the point.
        tolerance = 1e-9 if origin == 0 else 1e-7
        actual = symmetric(merged.covariance)[index]
        np.testing.assert_allclose(actual, covariance, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(merged.opacity[index], opacity, rtol=max(1e-9, tolerance))
        np.testing.assert_allclose(merged.sh[index], sh, rtol=1e-5, atol=1e-6)
        turned = rotation_matrix(merged.rotation[index : index + 1].astype(np.float64))[0]
        rebuilt = turned @ np.diag(merged.scale[index] ** 2) @ turned.T
        np.testing.assert_allclose(rebuilt, covariance, atol=3e-6 * np.trace(covariance))


@pytest.mark.parametrize("seed", range(4))
def test_mass_is_conserved_where_no_opacity_is_cut(seed):
    rng = np.random.default_rng(seed)
    members = mixture(rng, 200)
    faint_members = Mixture(
        **{name: getattr(members, name) for name in Mixture.__slots__ if name != "opacity"},
        opacity=members.opacity * 1e-3,
    )
    merged = merge_clusters(faint_members, np.arange(0, 200, 5))
    assert (merged.opacity < MAX_OPACITY).all()
    np.testing.assert_allclose(merged.mass.sum(), faint_members.mass.sum(), rtol=1e-9)


def test_a_single_member_stays_as_it_is():
    members = mixture(np.random.default_rng(0), 3)
    merged = merge_clusters(members, np.array([0, 1, 2]))
    for name in ("mean", "covariance", "scale", "rotation", "opacity"):
        np.testing.assert_array_equal(getattr(merged, name), getattr(members, name))
    np.testing.assert_allclose(merged.sh, members.sh, rtol=1e-6)


def test_duplicates_keep_their_shape_but_for_the_widening():
    single = mixture(np.random.default_rng(3), 1)
    duplicates = single.rows(np.zeros(7, np.int64))
    merged = merge_clusters(duplicates, np.array([0]), widen=1.0)
    np.testing.assert_allclose(merged.covariance, single.covariance, rtol=1e-9)
    np.testing.assert_allclose(merged.mean, single.mean, rtol=1e-12)
    assert merged.opacity[0] == pytest.approx(min(7 * single.opacity[0], MAX_OPACITY))


def test_invisible_members_do_not_move_the_mean():
    members = mixture(np.random.default_rng(1), 4)
    members.opacity[[1, 3]] = 0
    merged = merge_clusters(members, np.array([0, 2, 3]))
    np.testing.assert_array_equal(merged.mean, members.mean[[0, 2]])
    np.testing.assert_array_equal(merged.code, members.code[[0, 2]])


def test_invisible_members_merge_into_one_invisible_splat():
    members = mixture(np.random.default_rng(1), 4)
    members.opacity[:] = 0
    merged = merge_clusters(members, np.array([0, 2]))
    assert len(merged) == 1
    assert merged.opacity[0] == 0


@pytest.mark.parametrize("flat", [0.0, 1e-200])
def test_flat_splats_have_the_area_of_their_disc(flat):
    area = surface_area(np.array([[3.0, 2.0, flat]]))
    np.testing.assert_allclose(area, 4 * math.pi * 6 / 3 ** (1 / P), rtol=1e-12)


def test_a_needle_and_a_point_have_no_area():
    np.testing.assert_array_equal(surface_area(np.array([[3.0, 0, 0], [0, 0, 0]])), [0, 0])


def test_a_ball_has_the_surface_of_a_ball():
    np.testing.assert_allclose(surface_area(np.full((1, 3), 2.0)), 16 * math.pi, rtol=1e-12)


def test_one_enormous_splat_does_not_drown_the_digits_of_the_others():
    members = mixture(np.random.default_rng(5), 5)
    members.scale[2] = [1e5, 1e5, 1e5]
    members.covariance[2] = np.array([1e10, 0, 0, 1e10, 0, 1e10])
    merged = merge_clusters(members, np.array([0, 2, 3]))
    mean, *_ = merge_oracle(members, range(3, 5), 2.0, 1.1)
    np.testing.assert_allclose(merged.mean[2], mean, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_ellipsoids_are_rotations_with_a_fixed_sign(seed):
    rng = np.random.default_rng(seed)
    members = mixture(rng, 300)
    scale, rotation = ellipsoids(members.covariance)
    matrix = rotation_matrix(rotation)
    np.testing.assert_allclose(np.linalg.det(matrix), 1, atol=1e-5)
    rebuilt = (matrix * scale[:, None, :] ** 2) @ matrix.transpose(0, 2, 1)
    full = symmetric(members.covariance)
    size = np.trace(full, axis1=1, axis2=2)[:, None, None]
    assert (np.abs(rebuilt - full) <= 5e-6 * size).all()
    # Noise in the last bits, as between machines, moves no quaternion by more than rounding.
    noisy = members.covariance * (1 + rng.uniform(-1e-15, 1e-15, members.covariance.shape))
    has_distinct_scales = np.diff(scale, axis=1).min(axis=1) > 1e-3 * scale.max(axis=1)
    np.testing.assert_allclose(
        ellipsoids(noisy)[1][has_distinct_scales], rotation[has_distinct_scales], atol=1e-5
    )


def test_balls_are_not_rotated():
    ball = np.array([[2.0, 0, 0, 2.0, 0, 2.0], [0, 0, 0, 0, 0, 0]])
    scale, rotation = ellipsoids(ball)
    np.testing.assert_array_equal(rotation, [[1, 0, 0, 0]] * 2)
    np.testing.assert_allclose(scale, [[math.sqrt(2)] * 3, [0] * 3])


def test_joined_parts_are_in_order_of_their_codes():
    rng = np.random.default_rng(0)
    parts = [mixture(rng, 5), mixture(rng, 3)]
    parts[1].code[:] = parts[0].code[:3]
    joined = concatenate(parts)
    assert (np.diff(joined.code.astype(np.float64)) >= 0).all()
    first = np.searchsorted(joined.code, parts[0].code[0])
    np.testing.assert_array_equal(joined.mean[first], parts[0].mean[0])
    np.testing.assert_array_equal(joined.mean[first + 1], parts[1].mean[0])

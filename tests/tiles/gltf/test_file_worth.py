"""The worth of a file is the similarity of what it stores to what the tile holds."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.formats import Splats
from gsgen.formats.shared.quantities import sigmoid
from gsgen.tiles.gltf.encoding import write_content
from gsgen.tiles.gltf.file_worth import compare_stored
from support.splat_files import scene


def moved_copy(splats: Splats, seed: int, amount: float) -> Splats:
    rng = np.random.default_rng(seed)
    arrays = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    changes = {}
    for name in arrays:
        array = getattr(splats, name)
        size = np.exp(splats.log_scale.max()) if name == "position" else 1.0
        changes[name] = (array + amount * size * rng.normal(size=array.shape)).astype(np.float32)
    return replace(splats, **changes)


def summed_worth(splats: Splats, stored: Splats) -> float:
    """The same by sums: footprints over a grid in the plane, colours over directions."""
    directions = np.random.default_rng(1).normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    worth = weights = 0.0
    for row in range(len(splats)):
        matrices, covariances, colors = [], [], []
        for part in (splats, stored):
            axes = rotation_matrix(part.rotation[row : row + 1].astype(np.float64))[0]
            scale = np.exp(part.log_scale[row].astype(np.float64))
            matrices.append((axes, scale))
            covariances.append(axes @ np.diag(scale**2) @ axes.T)
            radiance = 0.5 + basis(directions, splats.degree) @ part.sh[row].astype(np.float64)
            colors.append(sigmoid(part.logit_opacity[row].astype(np.float64)) * radiance)
        axes, scale = matrices[0]
        longer = np.argsort(scale)[1:]
        plane = axes[:, longer]
        offset = plane.T @ (stored.position[row].astype(np.float64) - splats.position[row])
        reach = 6 * scale.max() + np.abs(offset).max()
        line = np.linspace(-reach, reach, 301)
        points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        footprints = []
        for covariance, center in zip(covariances, (np.zeros(2), offset), strict=True):
            inverse = np.linalg.inv(plane.T @ covariance @ plane)
            away = points - center
            footprints.append(np.exp(-0.5 * np.einsum("ni,ij,nj->n", away, inverse, away)))
        g, h = footprints
        overlap = (g * h).sum() / np.sqrt((g * g).sum() * (h * h).sum())
        a, b = colors
        likeness = 2 * (a * b).sum() / ((a * a).sum() + (b * b).sum())
        weight = sigmoid(splats.logit_opacity[row]) * np.prod(scale[longer])
        worth, weights = worth + weight * overlap * likeness, weights + weight
    return float(worth / weights)


@pytest.mark.parametrize(("degree", "amount"), [(0, 0.05), (2, 0.1), (3, 0.3)])
def test_the_closed_form_is_the_sum_over_pixels_and_directions(degree: int, amount: float) -> None:
    splats = scene(6, degree, seed=degree)
    splats = replace(splats, log_scale=splats.log_scale.clip(-2, 0))
    stored = moved_copy(splats, degree, amount)
    assert compare_stored(splats, stored)[0] == pytest.approx(
        summed_worth(splats, stored), abs=0.01
    )


def test_the_same_splats_are_worth_one_and_far_ones_nothing() -> None:
    splats = scene(50, 1, seed=3)
    assert compare_stored(splats, splats)[0] == pytest.approx(1, abs=1e-6)
    far = replace(splats, position=splats.position + np.float32(1e3))
    assert compare_stored(splats, far)[0] == pytest.approx(0, abs=1e-6)
    unseen = replace(splats, logit_opacity=np.full(50, -1e3, np.float32))
    assert compare_stored(unseen, unseen)[0] == 1


def test_the_shift_is_the_mean_square_of_distances_by_opacity_and_area() -> None:
    splats = scene(40, 1, seed=4)
    stored = moved_copy(splats, 1, 0.2)
    scale = np.sort(np.exp(splats.log_scale.astype(np.float64)), axis=1)
    weight = scale[:, 1] * scale[:, 2] / (1 + np.exp(-splats.logit_opacity))
    distance = np.linalg.norm(stored.position.astype(np.float64) - splats.position, axis=1)
    expected = np.average(distance**2, weights=weight)
    assert compare_stored(splats, stored)[1] == pytest.approx(expected, rel=1e-6)


def test_a_coarser_quality_is_worth_less() -> None:
    splats = scene(2000, 1, seed=5)
    worth = [write_content(splats, np.zeros(3), quality=quality).worth for quality in range(5)]
    assert worth == sorted(worth, reverse=True)
    assert 0.8 < worth[4] < worth[2] < worth[0] <= 1
    assert write_content(splats, np.zeros(3), codec="khr").worth == 1

"""Splats merged to a number: as many as asked for, in the place of those before."""

import numpy as np
import pytest

from gsgen.formats.merging.decimation import decimate
from gsgen.formats.merging.mixture import surface_area
from gsgen.formats.shared.quantities import sigmoid
from support.splat_files import assert_near, scene


@pytest.mark.parametrize("count", [1, 7, 50, 333, 999])
@pytest.mark.parametrize("degree", [0, 2])
def test_decimation_gives_at_most_the_target_count(count, degree):
    splats = scene(1000, degree, seed=count)
    merged = decimate(splats, count)
    assert 0.85 * count - 7 <= len(merged) <= count
    low, high = splats.position.min(axis=0), splats.position.max(axis=0)
    assert ((merged.position >= low) & (merged.position <= high)).all()


def test_mass_is_conserved_where_nothing_is_opaque():
    splats = scene(500, 0)
    splats.logit_opacity[:] = -4

    def mass(splats) -> float:
        return float((sigmoid(splats.logit_opacity) * surface_area(np.exp(splats.log_scale))).sum())

    assert mass(decimate(splats, 100)) == pytest.approx(mass(splats), rel=0.02)


def test_enough_splats_stay_as_they_are():
    splats = scene(30, 1)
    assert_near(decimate(splats, 30), splats)


def test_splats_in_one_place_become_one():
    splats = scene(20, 0)
    splats.position[:] = 1
    assert len(decimate(splats, 5)) == 1

"""The declared box around all centres."""

import numpy as np
import pytest

from gsgen.contract.spec.fields.scene import Bounds


def test_a_box_has_its_margin_on_each_side() -> None:
    points = np.array([[0, 1, -2], [10, 1, 2], [5, np.nan, 9]])  # the last one is left out
    bounds = Bounds.from_points(points, 0.1)
    assert bounds is not None
    assert bounds.min == pytest.approx((-1, 1, -2.4), abs=2e-6)
    assert bounds.max == pytest.approx((11, 1, 2.4), abs=2e-6)


@pytest.mark.parametrize("height", [0.0, 1.0, 1234.5678, -98765.4321, 3.3333333e-5])
def test_a_flat_box_holds_its_points(height: float) -> None:
    """Six digits of a corner, rounded to nearest, may lie on the other side of the points."""
    bounds = Bounds.from_points(np.array([[0, height, 0], [1, height, 1]]), 0.0)
    assert bounds is not None
    assert bounds.min[1] <= height <= bounds.max[1]
    assert bounds.max[1] - bounds.min[1] <= 4e-6 + 2e-5 * abs(height)


def test_no_point_has_no_box() -> None:
    assert Bounds.from_points(np.full((3, 3), np.inf), 0.1) is None
    assert Bounds.from_points(np.zeros((0, 3)), 0.1) is None

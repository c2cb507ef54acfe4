import itertools

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.clouds import cloud
from gsgen.contract.causes.explanations import explain_rows

ORDERS = {
    "": [0, 1, 2, 3, 4, 5],
    "xx yy zz xy xz yz": [0, 3, 5, 1, 2, 4],
    "xx yy zz yz xz xy (Voigt)": [0, 3, 5, 4, 2, 1],
    "xx xy yy xz yz zz (lower triangle)": [0, 1, 3, 2, 4, 5],
}


def rows_in(order, count=200):
    result = cloud(count)
    upper = result.covariance[:, ORDERS[order]]
    return np.concatenate([result.position, result.opacity[:, None], upper], axis=1)


@pytest.mark.parametrize("order", ORDERS)
def test_field_order_is_recognised_from_values(order):
    actual = explain_rows(rows_in(order))
    assert (actual.name if actual else "") == order
    assert actual is None or (actual.declared > 0.2 and actual.fraction == 0)


def test_too_few_rows_prove_nothing():
    assert explain_rows(rows_in("xx yy zz xy xz yz", 15)) is None


def test_rows_without_a_fitting_order_give_no_finding():
    noise = np.random.default_rng(1).normal(size=(200, 10))
    assert explain_rows(noise) is None


def test_rows_that_are_not_finite_do_not_count():
    rows = rows_in("")
    rows[::2] = np.nan
    assert explain_rows(rows) is None


BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


def _joined(*names):
    gaussians = cloud(200, seed=3)
    rng = np.random.default_rng(4)
    turns = rng.normal(size=(200, 4))
    parts = {
        "position": gaussians.position,
        "opacity": gaussians.opacity[:, None],
        "covariance": gaussians.covariance,
        "log scale": np.log(rng.uniform(0.02, 0.2, (200, 3))),
        "quaternion": turns / np.linalg.norm(turns, axis=1, keepdims=True),
    }
    return np.concatenate([parts[name] for name in names], axis=1)


@pytest.mark.parametrize(
    ("columns", "name"),
    [
        (("opacity", "position", "covariance"), "opacity first"),
        (("position", "covariance", "opacity"), "opacity last"),
        (("covariance", "position", "opacity"), "the covariance first, then x y z"),
        (("covariance", "opacity", "position"), "the covariance first, then opacity"),
        (("position", "log scale", "quaternion"), "three log scales, a quaternion"),
        (("position", "quaternion", "log scale"), "a quaternion, three log scales"),
    ],
)
def test_columns_in_another_order_are_named(columns, name):
    order = explain_rows(_joined(*columns), BOX)
    assert order is not None
    assert name in order.name


def test_planes_that_were_reshaped_are_named():
    right = rows_in("")
    order = explain_rows(right.T.reshape(right.shape), BOX, right)
    assert order is not None
    assert order.name.startswith("ten planes")


def test_a_cholesky_factor_is_named():
    right = rows_in("")
    sigma = right[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    factor = np.linalg.cholesky(sigma)[:, [0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]]
    order = explain_rows(np.concatenate([right[:, :4], factor], axis=1), BOX)
    assert order is not None
    assert "Cholesky" in order.name


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("fault", ["bytes", "logits", "diagonal bytes"])
def test_a_wrong_opacity_is_no_other_layout(fault, seed):
    """Also of axis-aligned Gaussians, whose off-diagonal zeros fit many columns."""
    gaussians = cloud(200, seed=seed)
    opacity = gaussians.opacity * 255
    if fault == "logits":
        opacity = np.log(gaussians.opacity / (1 - gaussians.opacity)) * 3 + 1
    upper = gaussians.covariance * ([1, 0, 0, 1, 0, 1] if "diagonal" in fault else 1)
    rows = np.concatenate([gaussians.position, opacity[:, None], upper], axis=1)
    assert explain_rows(rows, BOX, rows.reshape(10, -1).T) is None
    rows[:, :3] = gaussians.position / 4 + 0.5  # a centre's x could be an opacity
    assert 0 < rows[:, :3].min() < rows[:, :3].max() < 1
    assert explain_rows(rows, None, rows.reshape(10, -1).T) is None


@pytest.mark.parametrize("parts", range(6))
@pytest.mark.parametrize("order", ["", "xx yy zz xy xz yz", "xx xy yy xz yz zz (lower triangle)"])
def test_every_order_of_parts_and_entries_is_found(parts, order):
    position, opacity, covariance = np.split(rows_in(order), [3, 4], axis=1)
    arrangements = list(itertools.permutations((position, opacity, covariance)))
    rows = np.concatenate(arrangements[parts], axis=1)
    result = explain_rows(rows)
    assert (result is None) is (not order and parts == 0)


def test_an_opacity_behind_thin_covariances_is_found():
    gaussians = cloud(200, seed=3)
    perturbation = 1e-6 * gaussians.covariance
    rows = np.concatenate([gaussians.position, perturbation, gaussians.opacity[:, None]], axis=1)
    assert explain_rows(rows).name == "x y z, the covariance, opacity last"


def test_bounds_of_the_wrong_columns_hide_no_order():
    gaussians = cloud(200, seed=3)
    planes = np.concatenate(
        [gaussians.position, gaussians.opacity[:, None], gaussians.covariance], axis=1
    )
    rows = planes.T.reshape(200, 10)
    box = (tuple(rows[:, :3].min(0)), tuple(rows[:, :3].max(0)))
    assert "ten planes" in explain_rows(rows, box, rows.reshape(10, -1).T).name


def test_entries_that_float16_rounds_to_its_step_are_no_other_order():
    gaussians = cloud(200, seed=3)
    rows = np.concatenate(
        [gaussians.position, gaussians.opacity[:, None], 3e-7 * gaussians.covariance], axis=1
    )
    assert explain_rows(rows.astype(np.float16).astype(float), rounding_error=2.0**-25) is None

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.clouds import cloud
from gsgen.contract.probing.field_order import suspect_order

ORDERS = {
    "": [0, 1, 2, 3, 4, 5],
    "xx yy zz xy xz yz": [0, 3, 5, 1, 2, 4],
    "xx xy yy xz yz zz": [0, 1, 3, 2, 4, 5],
}


def rows_in(order, count=200):
    made = cloud(count)
    upper = made.covariance[:, ORDERS[order]]
    return np.concatenate([made.position, made.opacity[:, None], upper], axis=1)


@pytest.mark.parametrize("order", ORDERS)
def test_an_order_is_told_from_the_numbers(order):
    found = suspect_order(rows_in(order))
    assert (found.name if found else "") == order
    assert found is None or (found.declared > 0.2 and found.fraction == 0)


def test_too_few_rows_prove_nothing():
    assert suspect_order(rows_in("xx yy zz xy xz yz", 15)) is None


def test_rows_that_fit_no_order_are_not_accused():
    noise = np.random.default_rng(1).normal(size=(200, 10))
    assert suspect_order(noise) is None


def test_rows_that_are_not_finite_do_not_count():
    rows = rows_in("")
    rows[::2] = np.nan
    assert suspect_order(rows) is None

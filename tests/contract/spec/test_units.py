"""Limits of float16 agree with NumPy; sizes have a unit."""

import numpy as np
import pytest

from gsgen.contract.spec import units


def test_the_limits_of_float16_are_those_of_numpy():
    limits = np.finfo(np.float16)
    assert float(limits.max) == units.FLOAT16_MAX
    assert float(limits.smallest_normal) == units.FLOAT16_SMALLEST_NORMAL
    assert float(limits.eps) == units.FLOAT16_EPSILON


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (0, "0 B"),
        (1023, "1023 B"),
        (1024, "1.0 KiB"),
        (12700, "12.4 KiB"),
        ((1 << 20) - 1, "1024.0 KiB"),
        (1 << 20, "1.0 MiB"),
        (3 << 30, "3072.0 MiB"),
    ],
)
def test_a_size_has_the_largest_unit_below_it(size, text):
    assert units.format_bytes(size) == text


def test_mebibytes_have_as_many_decimals_as_are_asked_for():
    assert units.format_mebibytes(3 << 19) == "1.5 MiB"
    assert units.format_mebibytes(200 << 20, 0) == "200 MiB"

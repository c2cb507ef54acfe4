"""Kernels count the first digits of the keys that they write as their NumPy twin does."""

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.first_digits import FirstDigits
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.renderer.renderer import Renderer
from references.sorting import first_digits_reference
from support.rendering.first_digits import CASES, counted, like_gpu


@pytest.fixture(scope="module")
def large_tiles(device: Device) -> Renderer:
    return Renderer(like_gpu(device), rasteriser="tiles")


@pytest.mark.parametrize("name", CASES)
def test_digit_counts_agree_with_numpy(large_tiles: Renderer, name: str) -> None:
    for result, expected in counted(large_tiles, CASES[name]()).values():
        np.testing.assert_array_equal(result, expected)
        assert expected.any() == (name != "nothing")


def test_cases_cover_block_and_capacity_limits(large_tiles: Renderer) -> None:
    """A workgroup's pairs are in many blocks; digits are one, or all; the capacity is too small."""
    actual = {name: counted(large_tiles, CASES[name]()) for name in CASES}
    assert actual["over many blocks"]["tiles"][1].shape[1] > 20
    assert actual["beyond the capacity"]["tiles"][1].sum() == 5001
    assert np.count_nonzero(actual["at one depth and place"]["depths"][1].any(axis=1)) == 1
    assert actual["crowd"]["depths"][1].any(axis=1).all()
    assert actual["in slots"]["depths"][1].shape[1] > 4
    assert actual["in one tile"]["tiles"][1].shape[0] == 2


def test_the_twin_counts_present_keys_by_block() -> None:
    keys = np.array([0, 5, 5, NO_ID, 1, 4, 9], np.uint32)
    table = first_digits_reference(keys, FirstDigits(4, 3))
    assert table.tolist() == [[1, 1, 0], [2, 1, 1], [0, 0, 0], [0, 0, 0]]
    assert first_digits_reference(keys[:0], FirstDigits(2, 3)).tolist() == [[0], [0]]

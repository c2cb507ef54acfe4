"""Pages of several splat sets, and the order of their Gaussians in the scene."""

from types import SimpleNamespace
from typing import cast

import numpy as np

from gsgen.runtime.renderer.placed_pages import Placed, scene_order


def pages_of(count: int, sizes: list[int], order: np.ndarray | None) -> list[Placed]:
    """Return the pages of a splat set; ``order`` has the set's row of each GPU row."""
    assert sum(sizes) == count
    pages, first = [], 0
    for size in sizes:
        rows = None if order is None else order[first : first + size]
        page = SimpleNamespace(first=first, capacity=size, rows_of=rows)
        pages.append(cast(Placed, (None, page)))
        first += size
    return pages


def test_rows_of_a_scene_are_counted_over_all_sets_and_pages() -> None:
    rng = np.random.default_rng(3)
    order = rng.permutation(9).astype(np.uint32)
    placed = [*pages_of(5, [5], None), *pages_of(9, [4, 5], order), *pages_of(6, [2, 4], None)]
    result = scene_order(placed)
    assert result is not None
    assert result.dtype == np.uint32
    np.testing.assert_array_equal(result, [*range(5), *(5 + order), *range(14, 20)])


def test_sets_in_their_own_order_need_no_table() -> None:
    assert scene_order([*pages_of(5, [5], None), *pages_of(6, [2, 4], None)]) is None

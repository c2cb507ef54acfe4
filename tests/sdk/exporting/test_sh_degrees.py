"""Degrees of harmonics that consumers take."""

import pytest

from gsgen.sdk.exporting.sh_degrees import stored_degree


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("half", [False, True])
def test_stored_degree_fills_words_and_changes_are_explained(degree: int, half: bool) -> None:
    stored, reason = stored_degree(degree, half=half)
    size = 2 if half else 4
    assert 3 * size * (stored + 1) ** 2 % 4 == 0
    fewest = next(d for d in range(degree, 4) if 3 * size * (d + 1) ** 2 % 4 == 0)
    assert stored == fewest
    assert bool(reason) == (stored != degree)
    assert stored_degree(degree, half=half, target="visionary")[0] == 3

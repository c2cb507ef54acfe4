import numpy as np
import pytest
import torch

from gsgen.sdk import Gaussians, GeneratorInvalid, math


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("capacity", [1, 40, 100, 500])
def test_kept_rows_stand_in_front_in_order(share: float, capacity: int) -> None:
    mask = (np.random.default_rng(4).random(100) < share).astype(np.float32)
    rows, count = math.keep_rows(torch.from_numpy(mask), capacity)
    expected = np.flatnonzero(mask)[:capacity]
    assert rows.shape == (min(capacity, 100),)
    assert (rows.dtype, count.dtype, count.shape) == (torch.int32, torch.int32, (1,))
    assert count.item() == len(expected)
    assert rows[: len(expected)].tolist() == expected.tolist()
    trailing_rows = rows[len(expected) :].numpy()
    assert len(set(rows.tolist())) == len(rows)
    assert (mask[trailing_rows] == 0).all() or len(expected) == capacity


def test_row_numbers_stay_exact_at_the_largest_size() -> None:
    mask = torch.zeros(1 << 24)
    picked_rows = [0, 1, (1 << 24) - 2, (1 << 24) - 1]
    mask[picked_rows] = 1
    rows, count = math.keep_rows(mask, 4)
    assert rows.tolist() == picked_rows
    assert count.item() == 4


def test_the_best_rows_are_taken() -> None:
    score = torch.tensor([0.3, 0.9, -1.0, 0.5])
    assert math.top_rows(score, 2).tolist() == [1, 3]
    assert math.top_rows(score, 9).tolist() == [1, 3, 0, 2]


def test_gaussians_are_taken_field_by_field() -> None:
    n = 4
    line = torch.arange(n, dtype=torch.float32)
    gaussians = Gaussians(
        position=line[:, None].expand(n, 3),
        opacity=line,
        scale=line[:, None].expand(n, 3),
        rotation=line[:, None].expand(n, 4),
        sh=line[:, None, None].expand(n, 4, 3),
    )
    selected = gaussians.take(torch.tensor([3, 1], dtype=torch.int32), torch.tensor([1]))
    for value in (
        selected.position,
        selected.opacity,
        selected.scale,
        selected.rotation,
        selected.sh,
    ):
        assert value is not None
        assert value.reshape(2, -1)[:, 0].tolist() == [3, 1]
    assert selected.covariance is None
    assert selected.rgb is None
    assert selected.count is not None
    assert selected.count.tolist() == [1]


def test_no_capacity_is_refused() -> None:
    for call in (math.keep_rows, math.top_rows):
        with pytest.raises(GeneratorInvalid, match="capacity is 0, expected 1 or more"):
            call(torch.ones(3), 0)
    with pytest.raises(GeneratorInvalid, match="have 16777217 rows, expected 16777216 at most"):
        math.keep_rows(torch.ones(1).expand((1 << 24) + 1), 3)

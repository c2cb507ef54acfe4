"""Partitions, and which splats they hold."""

from types import SimpleNamespace

import numpy as np
import pytest

from gsgen.formats.merging.morton import DEPTH, Cube
from gsgen.tiles.build.plan import (
    coordinates_of,
    depth_of,
    group_small_octants,
    make_partitions,
    partition_of,
)
from gsgen.tiles.build.scan import anchor_depths, location_codes
from gsgen.tiles.build.source import BLOCK_ROWS, _ranges


def location_oracle(code: int, anchor: int, depth: int) -> int:
    level = min(anchor, depth)
    return 1 << 3 * level | code >> 3 * (DEPTH - level)


def test_a_location_names_its_depth_and_its_coordinates():
    assert depth_of(1) == 0
    assert depth_of(0b1_101_011) == 2
    assert coordinates_of(0b1_101_011) == (0b11, 0b01, 0b10)
    codes = np.array([0, (1 << 63) - 1, 12345678901234567], np.uint64)
    anchors = np.array([0, 21, 3])
    for depth in (0, 2, 7, 21):
        expected = [
            location_oracle(code, anchor, depth)
            for code, anchor in zip(codes.tolist(), anchors.tolist(), strict=True)
        ]
        assert location_codes(codes, anchors, depth).tolist() == expected


@pytest.mark.parametrize("leaf", [0, 40])
@pytest.mark.parametrize("seed", range(5))
def test_every_splat_is_in_one_partition(seed, leaf):
    rng = np.random.default_rng(seed)
    count, depth, limit = 3000, 6, 200
    codes = rng.integers(0, 1 << 63, count, dtype=np.uint64)
    codes[: count // 2] >>= np.uint64(20)  # half of them in one corner
    anchors = rng.integers(0, 12, count)
    cells, counts = np.unique(location_codes(codes, anchors, depth), return_counts=True)
    partitions, top_level = make_partitions(cells, counts, limit, leaf)
    partition_index = partition_of(codes, anchors, partitions)
    assert (partition_index >= 0).all()
    np.testing.assert_array_equal(
        np.bincount(partition_index, minlength=len(partitions)), [part.count for part in partitions]
    )
    for part in partitions:
        assert part.parent_cell in (*top_level, 0)
        divisible = depth_of(part.locations[0]) < depth
        assert part.count <= limit or part.is_anchored or not divisible
        if len(part.locations) > 1:
            assert part.count <= leaf
        for row in np.flatnonzero(partition_index == part.index)[:20].tolist():
            code, anchor = int(codes[row]), int(anchors[row])
            level = depth_of(part.locations[0])
            assert location_oracle(code, 99, level) in part.locations
            assert anchor == level if part.is_anchored else anchor >= level
    assert [depth_of(cell) for cell in top_level] == sorted(map(depth_of, top_level), reverse=True)


def test_small_neighbours_are_grouped_and_large_ones_are_alone():
    assert group_small_octants([20, 1, 90, 5, 5, 200, 3], 100) == [[0, 1], [2, 3, 4], [5], [6]]
    assert group_small_octants([20, 1], 0) == [[0], [1]]
    assert group_small_octants([], 10) == []


def test_large_splats_are_anchored_where_tiles_are_twice_their_reach():
    cube = Cube((0.0, 0.0, 0.0), 64.0)
    sigma = np.array([64.0, 32 / 3, 32 / 3 / 1.01, 1 / 3, 1e-30, 1e30])
    log_scale = np.log(sigma)[:, None].repeat(3, axis=1).astype(np.float32) - [0, 1, 2]
    depths = anchor_depths(log_scale.astype(np.float32), cube)
    for size, depth in zip(sigma, depths.tolist(), strict=True):
        side = cube.side / 2**depth
        assert 3 * size <= side / 2 * (1 + 1e-5) or depth == 0
        assert 3 * size > side / 4 * (1 - 1e-5) or depth == DEPTH
    flat = np.full((1, 3), -np.inf, np.float32)
    assert anchor_depths(flat, cube).tolist() == [DEPTH]


@pytest.mark.parametrize(("chunk_blocks", "step"), [(0.5, 1), (1, 1), (2.9, 2), (100, 4)])
def test_chunks_are_whole_blocks_of_rows(chunk_blocks, step):
    count, row_bytes = 3 * BLOCK_ROWS + 5, 62 * 4
    file = SimpleNamespace(count=count, table=SimpleNamespace(row_bytes=row_bytes))
    ranges = list(_ranges(file, int(chunk_blocks * row_bytes * BLOCK_ROWS)))
    assert [first for first, _ in ranges] == list(range(0, count, step * BLOCK_ROWS))
    assert sum(rows for _, rows in ranges) == count
    assert list(_ranges(SimpleNamespace(count=count, table=None), 1)) == [(0, count)]

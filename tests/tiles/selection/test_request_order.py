"""The order of requests: worked by hand for a small tree, and kept by the planner for random ones."""

import numpy as np
import pytest

from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.selection.request_order import finer_file_order, missing_tiles, request_order
from gsgen.tiles.streaming.metrics import MetricsRecorder
from gsgen.tiles.streaming.planner import RequestPlanner
from support.tiles.request_trees import EYE, cut_of, ladder_of, tree_of

#      0
#    ┌─┴──┐
#    1    4        levels 0, 1, 2: (0), (1, 4), (2, 3, 5)
#   ┌┴┐   │
#   2 3   5
PARENTS = (-1, 0, 1, 1, 0, 4)


def test_order_is_by_level_then_error_then_index() -> None:
    tree = tree_of(PARENTS)
    cut = cut_of([True] * 6, [9.0, 2.0, 3.0, 7.0, 8.0, 3.0])
    assert request_order(tree, cut).tolist() == [0, 4, 1, 3, 2, 5]
    unseen = cut_of([True, True, False, True, True, False], [9.0, 2.0, 3.0, 7.0, 8.0, 3.0])
    assert request_order(tree, unseen).tolist() == [0, 4, 1, 3]


def test_infinite_errors_around_the_camera_come_first_in_their_level() -> None:
    cut = cut_of([True] * 6, [np.inf, 50.0, np.inf, 1.0, np.inf, np.inf])
    assert request_order(tree_of(PARENTS), cut).tolist() == [0, 4, 1, 2, 5, 3]


def test_missing_root_is_requested_alone() -> None:
    order = np.array([0, 4, 1, 3])
    loaded = np.zeros(6, bool)
    assert missing_tiles(order, loaded).tolist() == [0]
    loaded[0] = True
    assert missing_tiles(order, loaded).tolist() == [4, 1, 3]
    loaded[[1, 4]] = True
    assert missing_tiles(order, loaded).tolist() == [3]
    assert missing_tiles(np.array([], np.int64), loaded).tolist() == []


def test_finer_files_come_by_worth_times_area_per_byte() -> None:
    # Half diagonals are √3. Areas: min(√3 / distance, 1)² = 3/25, 3/100, 3/25, 3/25, 1, 3/25.
    tree = tree_of(PARENTS, [5.0, 10.0, 5.0, 5.0, 0.5, 5.0])
    ladder = ladder_of(
        [[100, 60, 20]] * 3 + [[50, 30, 10], [1000, 60, 20], [100, 60, 20]], [1, 0.9, 0.5]
    )
    quality = np.array([2, 2, 1, 2, 2, 0])
    # Gains per byte: 0: .12·.5/100 = 6e-4; 1: .03·.5/100 = 1.5e-4; 2: .12·.1/100 = 1.2e-4;
    # 3: .12·.5/50 = 1.2e-3; 4: 1·.5/1000 = 5e-4; 5 has its finest file.
    all_rows = np.ones(6, bool)
    assert finer_file_order(tree, ladder, quality, all_rows, EYE).tolist() == [3, 0, 4, 1, 2]
    drawn = np.array([True, True, False, False, True, True])
    assert finer_file_order(tree, ladder, quality, drawn, EYE).tolist() == [0, 4, 1]
    assert finer_file_order(tree, ladder, np.full(6, -1), all_rows, EYE).tolist() == []


def test_equal_gains_are_ordered_by_index() -> None:
    ladder = ladder_of([[100, 10]] * 6, [1, 0.5])
    order = finer_file_order(tree_of(PARENTS), ladder, np.ones(6, np.int64), np.ones(6, bool), EYE)
    assert order.tolist() == [0, 1, 2, 3, 4, 5]


class RecordingLink:
    """Connections that note each request, and deliver when the test says so."""

    def __init__(self, connections: int) -> None:
        self.connections, self.active, self.requests = connections, [], []

    @property
    def free_request_count(self) -> int:
        return self.connections - len(self.active)

    def request(self, tile: int) -> None:
        assert self.free_request_count > 0
        assert tile not in self.active
        self.active.append(tile)
        self.requests.append(tile)

    def progress(self, tile: int) -> float:
        return 0.2

    def cancel(self, tile: int) -> int:
        self.active.remove(tile)
        return 20


def stream_at_random(seed: int) -> list[int]:
    """Stream a random tree under random cameras; check the rules at each request."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 40))
    tree = tree_of([-1, *(int(rng.integers(0, row)) for row in range(1, count))])
    ladder = ladder_of([[100, 40]] * count, [1, 0.5])
    link = RecordingLink(int(rng.integers(1, 7)))
    planner = RequestPlanner(tree, link, MetricsRecorder(tree.parent, tree.size), None)
    held_levels, loaded = np.full(count, -1), np.zeros(count, bool)
    visible_mask = np.ones(count, bool)
    for frame in range(80):
        if frame % 8 == 0:
            visible_mask = rng.uniform(size=count) < 0.8
            visible_mask[0] = True
            for row in range(1, count):
                visible_mask[row] &= visible_mask[tree.parent[row]]
        cut = cut_of(visible_mask, rng.uniform(0, 50, count))
        planner.frame(Pose(float(frame), EYE, np.array([1.0, 0, 0, 0])), cut, loaded)
        before = len(link.requests)
        planner.fill(
            loaded, finer_file_order(tree, ladder, held_levels, visible_mask & loaded, EYE).tolist()
        )
        requests = link.requests[before:]
        assert loaded[0] or set(link.requests) <= {0}
        if (visible_mask & ~loaded).any():
            assert all(visible_mask[tile] and not loaded[tile] for tile in requests)
            key = [(tree.level[tile], -cut.error[tile], tile) for tile in requests]
            assert key == sorted(key)
        else:
            assert all(held_levels[tile] == 1 for tile in requests)
        for tile in list(link.active):
            if rng.uniform() < 0.5:
                link.active.remove(tile)
                held_levels[tile] = 0 if loaded[tile] else 1
                loaded[tile] = True
                planner.arrive(tile, float(frame))
    assert (held_levels == 0).any()
    return link.requests


@pytest.mark.parametrize("seed", range(40))
def test_planner_keeps_the_three_rules_and_repeats_itself(seed: int) -> None:
    assert stream_at_random(seed) == stream_at_random(seed)


def test_finer_request_is_cancelled_when_a_seen_tile_is_missing() -> None:
    tree = tree_of(PARENTS)
    link, recorder = RecordingLink(1), MetricsRecorder(tree.parent, tree.size)
    planner = RequestPlanner(tree, link, recorder, None)
    loaded = np.array([True, True, False, False, False, False])
    pose = Pose(0.0, EYE, np.array([1.0, 0, 0, 0]))
    planner.frame(pose, cut_of([True, True, False, False, False, False], [1.0] * 6), loaded)
    planner.fill(loaded, [1])
    assert link.active == [1]
    planner.frame(pose, cut_of([True, True, True, False, False, False], [1.0] * 6), loaded)
    planner.fill(loaded, [])
    assert link.active == [2]
    assert recorder.bytes == 20

"""The choice for the tiles that a camera sees, compared with all plans of small trees."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest

from gsgen.tiles.quality_ladder import QualityLadder
from gsgen.tiles.selection.cut import Cut
from gsgen.tiles.selection.exact import choose_cut_exactly
from gsgen.tiles.selection.seen_tiles import SeenTiles
from gsgen.tiles.selection.tile_tree import TileTree

WORTH = np.array([1.0, 0.9])
Plan = tuple[float, int, float]  # bytes, Gaussians, utility


class Scene:
    """A random tree of up to seven tiles, some of them there, some of them without a file."""

    def __init__(self, rng: np.random.Generator) -> None:
        count = int(rng.integers(1, 8))
        parent = np.r_[-1, [int(rng.integers(0, node)) for node in range(1, count)]].astype(int)
        level = np.zeros(count, int)
        for node in range(1, count):
            level[node] = level[parent[node]] + 1
        self.children = [np.flatnonzero(parent == node).tolist() for node in range(count)]
        self.tree = TileTree(
            tiles=(None,) * count,  # type: ignore[arg-type]
            parent=parent,
            level=level,
            center=np.zeros((count, 3)),
            half_axes=np.zeros((count, 3, 3)),
            error=np.zeros(count),
            is_leaf=np.array([not below for below in self.children]),
            adds=rng.uniform(size=count) < 0.3,
            size=np.ones(count, int),
            splats=rng.integers(1, 100, count),
            rows_of_level=tuple(np.flatnonzero(level == depth) for depth in range(max(level) + 1)),
        )
        size = np.sort(rng.integers(1, 100, (count, 2)), axis=1)[:, ::-1].astype(float)
        size[rng.uniform(size=count) < 0.2] = np.inf
        self.ladder = QualityLadder(tiles=(), size=size, worth=WORTH)
        seen = rng.uniform(size=count) < 0.8
        seen[0] = True
        for node in range(1, count):
            seen[node] &= seen[parent[node]]
        self.cut = Cut(seen, seen, rng.uniform(0, 500, count))
        self.held = np.where(np.isfinite(size[:, 0]), rng.integers(-1, 2, count), -1)
        self.dead = (rng.uniform(size=count) < 0.1) & (self.held < 0)
        self.weight = rng.uniform(0.1, 1, count)

    def problem(self) -> SeenTiles:
        weight = self.weight[self.cut.seen]
        return SeenTiles.of_cut(self.tree, self.ladder, self.cut, weight, self.held, self.dead)

    def files(self, tile: int) -> dict[int, float]:
        """Quality and missing bytes of the files that a tile may be drawn with."""
        if self.held[tile] >= 0:
            return {int(self.held[tile]): 0.0}
        sizes = self.ladder.size[tile]
        exists = np.isfinite(sizes[0]) and not self.dead[tile]
        return dict(enumerate(sizes.tolist())) if exists else {}

    def area(self, tile: int) -> float:
        below = [child for child in self.children[tile] if self.cut.seen[child]]
        return sum(map(self.area, below)) if below else float(self.weight[tile])

    def plans(self, tile: int) -> Iterator[Plan]:
        """All ways to draw what a tile covers."""
        below = [child for child in self.children[tile] if self.cut.seen[child]]
        files, splats = self.files(tile), int(self.tree.splats[tile])
        joins = bool(below) and bool(self.tree.adds[tile])
        yield 0.0, 0, 0.0
        if not joins:
            error = 0.0 if self.tree.is_leaf[tile] else float(self.cut.error[tile])
            value = self.area(tile) / (1 + error / 228)
            yield from ((size, splats, value * WORTH[q]) for q, size in files.items())
        if below:
            own: list[Plan] = [(0.0, 0, 0.0)]
            if joins:
                value = float(self.weight[tile])
                own += [(size, splats, value * WORTH[q]) for q, size in files.items()]
            elif files:
                own = [(files[max(files)], splats, 0.0)]
            for parts in itertools.product(own, *(list(self.plans(child)) for child in below)):
                yield tuple(map(sum, zip(*parts, strict=True)))  # type: ignore[misc]


@pytest.mark.parametrize("seed", range(60))
def test_the_best_choice_is_that_of_all_plans(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = Scene(rng)
    plans = np.array(list(scene.plans(0)))
    budget = float(np.quantile(plans[:, 0], rng.uniform(0, 1)))
    problem = scene.problem()
    choice = choose_cut_exactly(problem.options, budget)
    assert choice is not None
    assert choice.utility == pytest.approx(plans[plans[:, 0] <= budget, 2].max(), abs=1e-12)
    rows = np.flatnonzero(choice.option >= 0)
    total = problem.splats[rows, choice.option[rows]].sum()
    matches = np.isclose(plans[:, 0], choice.cost) & np.isclose(plans[:, 2], choice.utility)
    assert total in plans[matches, 1]

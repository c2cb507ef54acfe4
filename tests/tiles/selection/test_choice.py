"""Choices of options, compared with brute force and with an integer program."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, milp

from gsgen.tiles.selection.choose import choose_options
from gsgen.tiles.selection.cut_filling import fill_cut
from gsgen.tiles.selection.exact import DeadlineTile, choose_cut_exactly, choose_until_deadlines
from gsgen.tiles.selection.hulls import OptionHulls, upper_hulls
from gsgen.tiles.selection.joint_choice import choose_jointly
from gsgen.tiles.selection.tree_choice import CutOptions, TreeFrontier, choose_cut
from support.commands import gsgen_here
from support.tiles.quadtree_options import QuadtreeOptions


def random_tree(rng: np.random.Generator, nodes: int, qualities: int, *, branching: int = 4):
    """A tree whose fine nodes cost more and are worth more, with noise; whole-number bytes."""
    parent = np.full(nodes, -1)
    open_nodes = [0]
    for node in range(1, nodes):
        if (parent == open_nodes[0]).sum() >= rng.integers(1, branching + 1):
            open_nodes.pop(0)
        parent[node] = open_nodes[0]
        open_nodes.append(node)
    cost = np.sort(rng.integers(1, 1000, (nodes, qualities)), axis=1).astype(float)
    utility = np.cumsum(rng.uniform(0, 1, (nodes, qualities)), axis=1)
    utility *= rng.uniform(0.2, 3, (nodes, 1))
    hidden = rng.uniform(size=(nodes, qualities)) < 0.15
    hidden[:, 0] = False
    cost[hidden] = np.inf
    return CutOptions(parent, cost, utility)


def solve_by_milp(options: CutOptions, budget: float) -> float | None:
    nodes, qualities = options.cost.shape
    finite = np.isfinite(options.cost)
    is_leaf = ~np.isin(np.arange(nodes), options.parent)
    paths = []
    for leaf in np.flatnonzero(is_leaf):
        row = np.zeros((nodes, qualities))
        node = leaf
        while node >= 0:
            row[node] = 1
            node = options.parent[node]
        paths.append(row.ravel())
    cost = np.where(finite, options.cost, 0).ravel()
    solution = milp(
        -options.utility.ravel(),
        constraints=[
            LinearConstraint(np.array(paths), 1, 1),
            LinearConstraint(cost[None], -np.inf, budget),
        ],
        integrality=np.ones(nodes * qualities),
        bounds=(0, finite.ravel().astype(float)),
        options={"mip_rel_gap": 0},
    )
    return None if solution.x is None else -float(solution.fun)


def cuts(options: CutOptions, node: int = 0):
    """All cuts of a subtree as (cost, utility): straight from the definition."""
    for cost, utility in zip(options.cost[node], options.utility[node], strict=True):
        if np.isfinite(cost):
            yield cost, utility
    children = np.flatnonzero(options.parent == node)
    if len(children):
        for parts in itertools.product(*(list(cuts(options, c)) for c in children)):
            yield sum(p[0] for p in parts), sum(p[1] for p in parts)


def is_cut(options: CutOptions, chosen: np.ndarray) -> bool:
    """Whether every path from the root to a leaf has exactly one chosen option."""
    for leaf in np.flatnonzero(~np.isin(np.arange(len(chosen)), options.parent)):
        count, node = 0, leaf
        while node >= 0:
            count += chosen[node] >= 0
            node = options.parent[node]
        if count != 1:
            return False
    return True


@pytest.mark.parametrize("seed", range(60))
def test_small_cuts_are_those_of_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    options = random_tree(rng, int(rng.integers(1, 9)), int(rng.integers(1, 4)))
    all_cuts = list(cuts(options))
    budget = float(rng.uniform(0.5, 1.2) * np.median([cost for cost, _ in all_cuts]))
    best = max((u for c, u in all_cuts if c <= budget), default=None)
    choice = choose_cut_exactly(options, budget)
    frontier = TreeFrontier.of_options(options)
    live = choose_cut(frontier, budget)
    if best is None:
        assert choice is None
        assert live is None
        return
    assert choice is not None
    assert live is not None
    assert choice.utility == pytest.approx(best, rel=1e-12)
    filled = fill_cut(frontier, live, budget)
    assert filled.utility >= live.utility
    for result in (choice, live, filled):
        assert is_cut(options, result.option)
        assert result.cost <= budget
        rows = np.flatnonzero(result.option >= 0)
        assert result.cost == pytest.approx(options.cost[rows, result.option[rows]].sum())
        gain = options.utility[rows, result.option[rows]].sum()
        assert result.utility == pytest.approx(gain)
        assert result.utility <= best + 1e-9 <= result.bound + 2e-9


@pytest.mark.parametrize("seed", range(25))
def test_larger_cuts_are_those_of_an_integer_program(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    options = random_tree(rng, int(rng.integers(20, 130)), 3, branching=8)
    frontier = TreeFrontier.of_options(options)
    low, high = frontier.costs[0], frontier.costs[-1]
    budget = float(low + (high - low) * rng.uniform(0, 1))
    best = solve_by_milp(options, budget)
    choice = choose_cut_exactly(options, budget)
    assert best is not None
    assert choice is not None
    assert choice.utility == pytest.approx(best, rel=2e-6)
    assert choice.bound >= best - 1e-6
    assert is_cut(options, choice.option)
    assert choice.cost <= budget


@pytest.mark.parametrize("seed", range(5))
def test_what_the_frontier_leaves_is_spent_where_tiles_have_independent_worth(seed: int) -> None:
    """Steps of the frontier open whole subtrees there: its points lack up to half the utility."""
    rng = np.random.default_rng(seed)
    options = random_tree(rng, 400, 3, branching=8)
    options.utility[:] = np.sort(rng.uniform(0, 1, options.utility.shape), axis=1)
    frontier = TreeFrontier.of_options(options)
    low, high = frontier.costs[0], frontier.costs[-1]
    before, after = [], []
    for share in np.linspace(0.05, 0.95, 19):
        budget = float(low + share * (high - low))
        live = choose_cut(frontier, budget)
        assert live is not None
        filled = fill_cut(frontier, live, budget)
        assert is_cut(options, filled.option)
        rows = np.flatnonzero(filled.option >= 0)
        cost = options.cost[rows, filled.option[rows]].sum()
        gain = options.utility[rows, filled.option[rows]].sum()
        assert filled.cost == pytest.approx(cost)
        assert cost <= budget
        assert live.utility <= filled.utility == pytest.approx(gain)
        assert gain <= filled.bound * (1 + 1e-12)
        before.append(live.certificate)
        after.append(filled.certificate)
    assert np.mean(after) < 0.01
    assert max(after) < 0.05
    assert np.mean(after) < 0.5 * np.mean(before)


@pytest.mark.parametrize("nodes", [100, 1500])
def test_a_chain_of_any_depth_has_a_choice(nodes: int) -> None:
    rng = np.random.default_rng(nodes)
    cost, utility = rng.uniform(1, 9, (2, nodes, 1))
    options = CutOptions(np.arange(nodes) - 1, cost, utility)
    frontier = TreeFrontier.of_options(options)
    live = choose_cut(frontier, 5.0)
    assert live is not None
    filled = fill_cut(frontier, live, 5.0)
    best = utility[cost <= 5].max()
    assert live.utility <= filled.utility <= best <= filled.bound + 1e-9
    if nodes == 100:
        assert filled.utility == best


@pytest.mark.parametrize("seed", range(10))
def test_the_frontier_is_the_hull_of_all_cuts(seed: int) -> None:
    options = random_tree(np.random.default_rng(seed), 8, 2, branching=3)
    frontier = TreeFrontier.of_options(options)
    points = np.array(list(cuts(options)))
    order, alive = upper_hulls(points[None, :, 0], points[None, :, 1])
    hull = points[order[0][alive[0]]]
    np.testing.assert_allclose(np.c_[frontier.costs, frontier.levels[0].value], hull)
    for row, (cost, utility) in enumerate(hull):
        chosen = frontier.options_at(row)
        assert is_cut(options, chosen)
        rows = np.flatnonzero(chosen >= 0)
        assert options.cost[rows, chosen[rows]].sum() == pytest.approx(cost)
        assert options.utility[rows, chosen[rows]].sum() == pytest.approx(utility)


def test_hulls_are_those_of_a_straightforward_walk() -> None:
    rng = np.random.default_rng(0)
    cost = rng.integers(0, 20, (300, 7)).astype(float)
    value = rng.integers(0, 20, (300, 7)).astype(float)
    cost[rng.uniform(size=cost.shape) < 0.2] = np.inf
    order, alive = upper_hulls(cost, value)
    for row in range(len(cost)):
        points = sorted(
            (c, v) for c, v in zip(cost[row], value[row], strict=True) if np.isfinite(c)
        )
        hull: list[tuple[float, float]] = []
        for c, v in points:
            if hull and v <= hull[-1][1]:
                continue
            while hull and (
                hull[-1][0] == c
                or (
                    len(hull) > 1
                    and (hull[-1][1] - hull[-2][1]) * (c - hull[-2][0])
                    <= (v - hull[-2][1]) * (hull[-1][0] - hull[-2][0])
                )
            ):
                hull.pop()
            hull.append((c, v))
        columns = order[row][alive[row]]
        assert list(zip(cost[row, columns], value[row, columns], strict=True)) == hull


def test_independent_tiles_are_within_their_certificate() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        cost = np.sort(rng.integers(1, 50, (6, 4)), axis=1).astype(float)
        value = np.cumsum(rng.uniform(0, 1, (6, 4)), axis=1)
        weight = rng.uniform(0, 2, 6)
        weight[0] = 0
        budget = float(rng.integers(0, 150))
        choice = choose_options(OptionHulls.of_options(cost, value), weight, budget)
        best = max(
            sum(weight[i] * value[i, o] for i, o in enumerate(options) if o >= 0)
            for options in itertools.product(range(-1, 4), repeat=6)
            if sum(cost[i, o] for i, o in enumerate(options) if o >= 0) <= budget
        )
        rows = np.flatnonzero(choice.option >= 0)
        assert choice.cost == pytest.approx(cost[rows, choice.option[rows]].sum())
        assert choice.cost <= budget
        gain = (weight[rows] * value[rows, choice.option[rows]]).sum()
        assert choice.utility == pytest.approx(gain)
        assert choice.utility <= best + 1e-9 <= choice.bound + 2e-9


def test_a_thousand_tiles_are_within_a_thousandth() -> None:
    rng = np.random.default_rng(2)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        size = rng.lognormal(10, 1, (1000, 1)) * np.linspace(0.05, 1, 12)
        value = np.log1p(size / 1000) * rng.uniform(0.8, 1.2, size.shape)
        hulls = OptionHulls.of_options(size, value)
        choice = choose_options(hulls, rng.exponential(1, 1000), float(size[:, -1].sum() * 0.2))
        assert 0 <= choice.certificate <= 1e-3


@pytest.mark.parametrize("seed", range(60))
def test_deadlines_are_those_of_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tiles = [
        DeadlineTile(
            rng.integers(0, 6, int(rng.integers(0, 4))), rng.uniform(0, 1, 3), int(deadline)
        )
        for deadline in rng.integers(0, 12, int(rng.integers(1, 6)))
    ]
    tiles = [DeadlineTile(t.slots, t.utility[: len(t.slots)], t.deadline) for t in tiles]

    def utility(options: tuple[int, ...]) -> float:
        clock, total = 0, 0.0
        for tile, option in zip(tiles, options, strict=True):
            if option >= 0:
                clock += int(tile.slots[option])
                if clock > tile.deadline:
                    return -1.0
                total += float(tile.utility[option])
        return total

    best = max(map(utility, itertools.product(*(range(-1, len(t.slots)) for t in tiles))))
    choice = choose_until_deadlines(tiles)
    assert choice.utility == pytest.approx(best, abs=1e-12)
    assert utility(tuple(choice.option.tolist())) == pytest.approx(best, abs=1e-12)


PROBLEM = {
    "kind": "cut",
    "budget_bytes": 10,
    "loaded": [[1, 0]],
    "nodes": [
        {"parent": None, "bytes": [4], "utility": [1]},
        {"parent": 0, "bytes": [9], "utility": [2]},
        {"parent": 0, "bytes": [7, 11], "utility": [2, 9]},
    ],
}


def test_the_command_prints_the_choice(tmp_path: Path) -> None:
    file = tmp_path / "problem.json"
    file.write_text(json.dumps(PROBLEM))
    result = gsgen_here("tiles", "plan", file, "--json")
    assert result.code == 0, result.err
    document = json.loads(result.out)
    assert document["chosen"] == [[1, 0], [2, 0]]
    assert document["utility"] == 4
    assert document["bound"] >= 4
    assert "1: option 0" in gsgen_here("tiles", "plan", file).out
    deadlines = {
        "kind": "deadlines",
        "slot_s": 0.1,
        "tiles": [
            {"slots": [3], "utility": [5], "deadline": 3},
            {"slots": [2, 1], "utility": [4, 3], "deadline": 4},
        ],
    }
    file.write_text(json.dumps(deadlines))
    result = gsgen_here("tiles", "plan", file, "--json")
    assert json.loads(result.out)["chosen"] == [[0, 0], [1, 1]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "knapsack"}, "expected cut or deadlines"),
        ({"budget_bytes": 2, "loaded": []}, "enough for the cheapest choice of tiles"),
        ({"budget_bytes": -1}, "budget_bytes"),
        ({"loaded": [[1, 3]]}, "the index of a node, and the index of one of its qualities"),
        ({"loaded": [[1]]}, "[node, quality]"),
        ({"nodes": []}, "one node at least"),
        ({"nodes": [{"parent": 0, "bytes": [1], "utility": [1]}]}, "expected one tree"),
        ({"nodes": [{"bytes": [1], "utility": [1, 2]}]}, "1 finite numbers"),
        ({"nodes": [{"bytes": [-1], "utility": [1]}]}, "numbers of 0 or more"),
        ({"nodes": [{"bytes": [], "utility": []}]}, "one option at least"),
    ],
)
def test_a_wrong_problem_is_named(tmp_path: Path, change: dict, message: str) -> None:
    file = tmp_path / "problem.json"
    file.write_text(json.dumps(PROBLEM | change))
    result = gsgen_here("tiles", "plan", file)
    assert result.code == 4
    assert message in result.err
    assert "problem.json" in result.err
    assert "Traceback" not in result.err


def node_cuts(options: CutOptions, node: int = 0):
    """All cuts of a subtree as chosen pairs of a node and its quality."""
    for quality in np.flatnonzero(np.isfinite(options.cost[node])).tolist():
        yield [(node, quality)]
    children = np.flatnonzero(options.parent == node)
    if len(children):
        for parts in itertools.product(*(list(node_cuts(options, c)) for c in children)):
            yield [pair for part in parts for pair in part]


@pytest.mark.parametrize("seed", range(40))
def test_a_joint_choice_keeps_both_limits_and_its_certificate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    options = random_tree(rng, int(rng.integers(1, 9)), int(rng.integers(1, 4)))
    splats = rng.integers(1, 100, len(options.parent))
    totals = np.array(
        [
            np.sum([(options.cost[n, q], splats[n], options.utility[n, q]) for n, q in cut], axis=0)
            for cut in node_cuts(options)
        ]
    )
    bytes_, rows = np.quantile(totals[:, 0], rng.uniform(0.2, 1)), np.quantile(totals[:, 1], 0.5)
    fits = (totals[:, 0] <= bytes_) & (totals[:, 1] <= rows)
    table = np.repeat(splats[:, None], options.cost.shape[1], axis=1)
    choice = choose_jointly(options, table, byte_budget=bytes_, splat_budget=rows)
    if choice is None:
        # Prices reach the choices on the hull alone: those within both limits may lie inside.
        assert fits.mean() < 0.5
        return
    best = totals[fits, 2].max()
    chosen = np.flatnonzero(choice.option >= 0)
    assert is_cut(options, choice.option)
    assert choice.cost == pytest.approx(options.cost[chosen, choice.option[chosen]].sum())
    assert choice.cost <= bytes_
    assert splats[chosen].sum() <= rows
    gain = options.utility[chosen, choice.option[chosen]].sum()
    assert choice.utility == pytest.approx(gain)
    assert gain <= best + 1e-9 <= choice.bound + 2e-9


def test_a_joint_choice_is_close_to_its_bound_where_nodes_are_many() -> None:
    """A node covers what its children cover: coarse levels cost fewer Gaussians and bytes."""
    tree, both, gaps = QuadtreeOptions.random(5), 0, []
    for bytes_share, splat_share in itertools.product((0.1, 0.3, 0.7), repeat=2):
        budgets = tree.budgets(bytes_share, splat_share)
        choice = choose_jointly(tree.options, tree.splat_table, **budgets)
        assert choice is not None
        drawn = tree.splats[choice.option >= 0].sum()
        assert choice.cost <= budgets["byte_budget"]
        assert drawn <= budgets["splat_budget"]
        is_full = choice.cost > 0.9 * budgets["byte_budget"]
        both += is_full and drawn > 0.9 * budgets["splat_budget"]
        gaps.append(choice.certificate)
    assert both > 0
    assert min(gaps) >= 0
    assert np.mean(gaps) < 0.01


@pytest.mark.parametrize("seed", range(10))
def test_a_joint_choice_of_independent_tiles_is_that_of_an_integer_program(seed: int) -> None:
    """Tiles under nodes that are never drawn: no level is left to choose."""
    rng = np.random.default_rng(seed)
    parent = np.r_[-1, np.zeros(3, int), rng.integers(1, 4, 30)]
    is_leaf = ~np.isin(np.arange(len(parent)), parent)
    cost = np.sort(rng.integers(1, 1000, (len(parent), 4)), axis=1).astype(float)
    utility = np.cumsum(rng.uniform(0, 1, cost.shape), axis=1)
    cost[~is_leaf] = np.inf
    cost[:, 3] = utility[:, 3] = 0  # nothing
    budget = float(cost[is_leaf, 2].sum() * rng.uniform(0.1, 1))
    options = CutOptions(parent, cost, utility)
    splats = np.ones(cost.shape, int)
    choice = choose_jointly(options, splats, byte_budget=budget, splat_budget=1e9)
    best = solve_by_milp(options, budget)
    assert choice is not None
    assert best is not None
    assert is_cut(options, choice.option)
    chosen = np.flatnonzero(choice.option >= 0)
    assert choice.cost == pytest.approx(cost[chosen, choice.option[chosen]].sum())
    assert choice.cost <= budget
    assert choice.utility == pytest.approx(utility[chosen, choice.option[chosen]].sum())
    assert 0.97 * best <= choice.utility <= best * (1 + 1e-9) <= choice.bound * (1 + 2e-9)

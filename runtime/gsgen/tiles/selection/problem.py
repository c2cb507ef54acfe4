"""Reads tile choice problems from JSON: a tile tree with a byte budget, or deadlines."""

__all__ = ["Plan", "solve_problem"]

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.errors import InputUnreadable
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.json_values import MAX_JSON, JsonObject, parse_object
from gsgen.tiles.selection.choose import Choice
from gsgen.tiles.selection.exact import DeadlineTile, choose_cut_exactly, choose_until_deadlines
from gsgen.tiles.selection.tree_choice import CutOptions

MOST_CELLS: Final = 1 << 27
"""How many entries the table of a problem with deadlines may have: tiles × slots."""


@final
@dataclass(frozen=True, slots=True)
class Plan:
    """The best choice of tiles for a tile choice problem, with its utility and an upper bound.

    Attributes:
        utility: Of all chosen options together.
        chosen: Pairs of a node or tile and its option, ascending.
        bound: What the linear relaxation says that no choice exceeds; for deadlines, the
            utility, which the table proves.
    """

    utility: float
    chosen: tuple[tuple[int, int], ...]
    bound: float

    @classmethod
    def of_choice(cls, choice: Choice) -> "Plan":
        """Convert chosen file qualities of tiles to a plan: tiles, utility and its upper bound."""
        picked = np.flatnonzero(choice.option >= 0).tolist()
        chosen = tuple((index, int(choice.option[index])) for index in picked)
        return cls(choice.utility, chosen, choice.bound)


def solve_problem(path: Path) -> Plan:
    """Read a tile choice problem from a JSON file and solve it exactly.

    Raises:
        TilesetInvalid: The file does not hold a problem, or no choice fits its budget.
        InputUnreadable: The file cannot be read.
    """
    try:
        if path.stat().st_size > MAX_JSON:
            raise TilesetInvalid(
                f"the file has {path.stat().st_size:,} bytes",
                location=str(path),
                expected=f"{MAX_JSON:,} bytes or fewer",
            )
        data = path.read_bytes()
    except OSError as error:
        raise InputUnreadable(
            f"cannot be read: {error.strerror}",
            where=str(path),
            hint="Name a JSON file that describes the tiles to choose from.",
        ) from error
    problem = parse_object(data, f"{path}, ")
    kind = problem.text("kind")
    if kind == "cut":
        return Plan.of_choice(_solve_cut(problem))
    if kind == "deadlines":
        return Plan.of_choice(_solve_deadlines(problem))
    problem.refuse("kind", "cut or deadlines")


def _solve_cut(problem: JsonObject) -> Choice:
    options = _read_nodes(problem)
    for index, (node, quality) in enumerate(_read_loaded(problem)):
        known = 0 <= node < len(options.cost) and 0 <= quality < options.cost.shape[1]
        if not known or not np.isfinite(options.cost[node, quality]):
            raise TilesetInvalid(
                f"the loaded tile is [{node}, {quality}]",
                location=f"{problem.at('loaded')}[{index}]",
                expected="the index of a node, and the index of one of its qualities",
            )
        options.cost[node, quality] = 0.0
    budget = problem.number("budget_bytes", least=0)
    choice = choose_cut_exactly(options, budget)
    if choice is None:
        raise TilesetInvalid(
            f"the budget is {budget:,.0f} bytes",
            location=problem.at("budget_bytes"),
            expected="enough for the cheapest choice of tiles",
            hint="Raise the budget, or list the loaded nodes.",
        )
    return choice


def _read_nodes(problem: JsonObject) -> CutOptions:
    """Read the tile tree of a tile choice problem: one root, and file qualities for each leaf."""
    nodes = list(problem.objects("nodes"))
    if not nodes:
        problem.refuse("nodes", "one node at least")
    parent = np.full(len(nodes), -1, np.int64)
    for index, node in enumerate(nodes):
        if node.values.get("parent") not in (None, -1):
            parent[index] = node.whole("parent", most=len(nodes) - 1)
    roots = int((parent < 0).sum())
    if roots != 1 or not _reaches_root(parent):
        actual = f"{roots} nodes without a parent" if roots != 1 else "a cycle of parents"
        raise TilesetInvalid(actual, location=problem.at("nodes"), expected="one tree")
    tables = [_read_options(node, "bytes") for node in nodes]
    is_leaf = np.ones(len(nodes), bool)
    is_leaf[parent[parent >= 0]] = False
    for node, (sizes, _), leaf in zip(nodes, tables, is_leaf, strict=True):
        if leaf and not len(sizes):
            node.refuse("bytes", "one option at least, as the node has no children")
    widest = max(1, *(len(sizes) for sizes, _ in tables))
    cost, utility = np.full((len(nodes), widest), np.inf), np.zeros((len(nodes), widest))
    for index, (sizes, values) in enumerate(tables):
        cost[index, : len(sizes)], utility[index, : len(sizes)] = sizes, values
    return CutOptions(parent, cost, utility)


def _reaches_root(parent: np.ndarray) -> bool:
    """Return whether the parents of every node of a tile tree lead to a root."""
    above, steps = parent.copy(), 1
    while (above >= 0).any() and steps <= len(parent):
        above = np.where(above >= 0, above[above], -1)
        steps *= 2
    return bool((above < 0).all())


def _read_options(
    entry: JsonObject, costs: str
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Read the cost and the utility of each file quality of a tile."""
    sizes, values = entry.values.get(costs), entry.values.get("utility")
    if not isinstance(sizes, list):
        entry.refuse(costs, "an array of numbers")
    if not isinstance(values, list):
        entry.refuse("utility", "an array of numbers")
    cost = entry.numbers(costs, len(sizes))
    if (cost < 0).any():
        entry.refuse(costs, "numbers of 0 or more")
    return cost, entry.numbers("utility", len(sizes))


def _read_loaded(problem: JsonObject) -> Iterator[tuple[int, int]]:
    """Yield the tiles, with file quality, that a tile choice problem lists as already loaded."""
    loaded = problem.values.get("loaded", [])
    if not isinstance(loaded, list):
        problem.refuse("loaded", "an array of [node, quality]")
    for index, pair in enumerate(loaded):
        numbers = isinstance(pair, list) and len(pair) == 2
        if not (numbers and all(type(entry) is int for entry in pair)):
            raise TilesetInvalid(
                f"an entry of the loaded tiles is {pair!r:.40}",
                location=f"{problem.at('loaded')}[{index}]",
                expected="[node, quality], two whole numbers",
            )
        yield pair[0], pair[1]


def _solve_deadlines(problem: JsonObject) -> Choice:
    if "slot_s" in problem:
        problem.number("slot_s", least=0)
    tiles = []
    for entry in problem.objects("tiles"):
        slots, utility = _read_options(entry, "slots")
        if (slots != np.floor(slots)).any():
            entry.refuse("slots", "whole numbers")
        deadline = entry.whole("deadline", most=MOST_CELLS)
        tiles.append(DeadlineTile(slots.astype(np.int64), utility, deadline))
    cells = len(tiles) * (max((tile.deadline for tile in tiles), default=0) + 1)
    if cells > MOST_CELLS:
        raise TilesetInvalid(
            f"the tile choice problem has {cells:,} pairs of a tile and a download time slot",
            location=problem.at("tiles"),
            expected=f"{MOST_CELLS:,} or fewer",
            hint="Make the time slots longer, so that fewer lie before the last deadline.",
        )
    return choose_until_deadlines(tiles)

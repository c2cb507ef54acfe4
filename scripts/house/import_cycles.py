"""Finds import cycles of the product, with imports in functions and for type checkers."""

__all__ = ["import_cycles", "imports_of", "strong_components"]

import ast
from collections import defaultdict, deque
from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from house.repository import PythonFile, Repository, module_name
from house.violation import Measurement, Violation

Graph = dict[str, dict[str, int]]
"""Module → the modules that it imports → line of the import."""


def import_cycles(repository: Repository) -> Measurement:
    """Find groups of modules that import each other, each with a shortest cycle."""
    files = {module_name(file.path): file for file in repository.product}
    if not files:
        return Measurement([])
    graph: Graph = {name: imports_of(name, file, files) for name, file in files.items()}
    violations = []
    for component in strong_components(graph):
        violation = _violation(component, graph, files)
        if any(repository.selects(files[name].path) for name in component):
            violations.append(violation)
    return Measurement(violations, len(graph))


def strong_components(graph: Graph) -> list[list[str]]:
    """Return the groups of modules that reach each other, each sorted by name."""
    names = sorted(graph)
    numbers = {name: number for number, name in enumerate(names)}
    edges = [(numbers[name], numbers[target]) for name in names for target in graph[name]]
    rows, columns = np.array(edges, np.int64).reshape(-1, 2).T
    matrix = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(names), len(names)))
    _, labels = connected_components(matrix, directed=True, connection="strong")
    components: dict[int, list[str]] = defaultdict(list)
    for name, label in zip(names, labels, strict=True):
        components[label].append(name)
    return sorted(members for members in components.values() if len(members) > 1)


def imports_of(name: str, file: PythonFile, files: dict[str, PythonFile]) -> dict[str, int]:
    """Return the modules of the product that a module imports, with the line of the import."""
    targets: dict[str, int] = {}
    for node in file.nodes:
        for target in _targets(node, files):
            if target in files and target != name:
                targets.setdefault(target, getattr(node, "lineno", 0))
    return targets


def _targets(node: ast.AST, files: dict[str, PythonFile]) -> Iterator[str]:
    match node:
        case ast.Import(names=aliases):
            yield from (alias.name for alias in aliases)
        case ast.ImportFrom(module=str(module), names=aliases):
            for alias in aliases:
                submodule = f"{module}.{alias.name}"
                yield submodule if submodule in files else module
        case ast.Call(
            func=ast.Attribute(attr="import_module") | ast.Name(id="import_module"),
            args=[ast.Constant(value=str(module)), *_],
        ):
            yield module


def _violation(component: list[str], graph: Graph, files: dict[str, PythonFile]) -> Violation:
    cycle = _shortest_cycle(component, graph)
    steps = [
        f"{files[name].path}:{graph[name][target]} imports {target}"
        for name, target in zip(cycle, [*cycle[1:], cycle[0]], strict=True)
    ]
    return Violation(
        path=files[cycle[0]].path,
        line=graph[cycle[0]][cycle[1]],
        subject=" ".join(component),
        actual=f"{len(component)} modules import each other: {', '.join(steps)}",
        expected="imports that point downwards",
        hint="move what both need to a module below them, or let the lower one take a protocol",
    )


def _shortest_cycle(component: list[str], graph: Graph) -> list[str]:
    members = set(component)
    cycles = [_cycle_through(name, graph, members) for name in component]
    return min(cycles, key=len)


def _cycle_through(start: str, graph: Graph, members: set[str]) -> list[str]:
    """Return a shortest cycle through one module of a strong component."""
    previous: dict[str, str] = {}
    queue = deque([start])
    while queue:
        name = queue.popleft()
        for target in graph[name]:
            if target == start:
                cycle = [name]
                while cycle[-1] != start:
                    cycle.append(previous[cycle[-1]])
                return cycle[::-1]
            if target in members and target not in previous:
                previous[target] = name
                queue.append(target)
    raise AssertionError(f"{start} is in no cycle, though its component has several modules")

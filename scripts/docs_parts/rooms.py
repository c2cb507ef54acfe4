"""The rooms of the product: their order by import-linter, questions, imports and entry points."""

__all__ = [
    "PUBLIC_GROUPS",
    "Room",
    "called_units",
    "circles",
    "imported_units",
    "rank",
    "room_of",
    "rooms",
    "table",
]

import ast
import re
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import grimp

import gsgen  # noqa: F401 - whose path then has all four folders

ROOT = Path(__file__).parents[2]
FOLDERS = ("contract", "sdk", "runtime", "reference_plugins")
PUBLIC_GROUPS = {f"gsgen.{name}" for name in "commands fixtures generators rules targets".split()}  # noqa: SIM905
"""Entry-point groups that packages of third parties use, and the product's own upper rooms too."""


@dataclass(frozen=True, slots=True)
class Room:
    """A package of the product.

    Attributes:
        name: The import name, ``gsgen.contract.model``.
        folder: The folder, from the root of the repository.
        question: The first line of the docstring of its ``__init__``.
        modules: The number of its modules, ``__init__`` not counted.
    """

    name: str
    folder: str
    question: str
    modules: int


@cache
def _configuration() -> dict[str, dict]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


@cache
def _files() -> dict[str, Path]:
    """Return the product's files by the names of their modules."""
    files = {}
    for folder in FOLDERS:
        for path in (ROOT / folder).glob("gsgen/*/**/*.py"):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


def _is_package(module: str) -> bool:
    return _files()[module].name == "__init__.py"


@cache
def _imports() -> dict[str, set[str]]:
    """Return for each module the product's modules that it imports, also within functions."""
    roots = _configuration()["tool"]["importlinter"].get("root_packages", ["gsgen"])
    graph = grimp.build_graph(*roots, cache_dir=None)
    return {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}


@cache
def _layer_order() -> dict[str, int]:
    """Return the rank of each package and module that import-linter's layers name, 0 the lowest."""
    layers: dict[str, list[str]] = {}
    for contract in _configuration()["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers":
            container = contract.get("containers", [""])[0]
            names = re.findall(r"[\w.]+", " ".join(reversed(contract["layers"])))
            layers[container] = [f"{container}.{name}".lstrip(".") for name in names]

    def visit(name: str) -> Iterator[str]:
        for inner in layers.get(name, ()):
            yield from visit(inner)
        yield name

    return {name: number for number, name in enumerate(visit(""))}


@cache
def rooms() -> tuple[Room, ...]:
    """Return every room, lowest first; packages that layers do not name follow their parent."""
    packages = [name for name in _files() if _is_package(name)]
    return tuple(_room(name) for name in sorted(packages, key=rank))


def _layer(name: str) -> int:
    order = _layer_order()
    while name not in order:
        name = name.rpartition(".")[0]
    return order[name]


@cache
def _sharing() -> Counter[int]:
    """Return for each layer the number of packages that it holds."""
    return Counter(_layer(name) for name in _files() if _is_package(name))


@cache
def rank(unit: str) -> tuple[int, int, str]:
    """Return the position of a room, or of a module that layers name, as a sort key."""
    layer = _layer(unit)
    if not _is_package(unit) or _sharing()[layer] == 1:
        return layer, 0, unit
    # A room stands above its sub-rooms, except above one that imports it.
    depth = unit.count(".")
    return layer, depth if _imports_parent(unit) else -depth, unit


def _members(room: str) -> list[str]:
    return [name for name in _files() if name.rpartition(".")[0] == room and not _is_package(name)]


def _room(name: str) -> Room:
    path = _files()[name]
    docstring = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    folder = path.parent.relative_to(ROOT).as_posix()
    return Room(name, folder, docstring.partition("\n")[0], len(_members(name)))


def _imports_parent(name: str) -> bool:
    """Return whether a module of the room imports a module directly in the parent room."""
    siblings = set(_members(name.rpartition(".")[0]))
    return any(_imports().get(member, set()) & siblings for member in _members(name))


def room_of(module: str) -> str:
    """Return the package of a module."""
    return module if _is_package(module) else module.rpartition(".")[0]


def _unit_of(module: str) -> str:
    """Return the module itself if layers name it, else its room."""
    return module if module in _layer_order() else room_of(module)


@cache
def imported_units() -> dict[str, set[str]]:
    """Return for each room, and each module that layers name, the others that it imports."""
    imported: dict[str, set[str]] = defaultdict(set)
    for name in _files():
        if not _is_package(name):  # a door imports what it opens to
            targets = _imports().get(name, set()) & set(_files())
            imported[_unit_of(name)] |= {_unit_of(target) for target in targets}
    return {name: targets - {name} for name, targets in imported.items()}


@cache
def called_units() -> set[tuple[str, str, str]]:
    """Return the calls that no import shows: the calling room, the called one, and the name.

    A call goes through an entry-point group that a module of the caller reads, or through the name
    of a module in a string.
    """
    groups = _configuration()["project"]["entry-points"]
    providers = {
        group: {target.partition(":")[0].strip() for target in entries.values()}
        for group, entries in groups.items()
    }
    calls = set()
    for name, path in _files().items():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                word = node.value
                named = {word.partition(":")[0]} & set(_files())
                modules = {module for module in named if not _is_package(module)}
                for target in providers.get(word, modules) & set(_files()):
                    calls.add((_unit_of(name), _unit_of(target), word))
    return {call for call in calls if call[0] != call[1]}


def circles() -> list[set[str]]:
    """Return the groups of rooms and modules that import each other in a circle."""
    units = {_unit_of(name) for name in _files()}
    reached = {unit: set(imported_units().get(unit, set())) for unit in units}
    for between in reached:  # Warshall's closure
        for targets in reached.values():
            if between in targets:
                targets |= reached[between]
    groups = {
        frozenset(name for name in reached if name in reached[start] and start in reached[name])
        for start in reached
    }
    return [set(group) for group in groups if group]


def table() -> str:
    """Return a table of all rooms with modules: folder and question, lowest first."""
    lines = ["| room | its question |", "|---|---|"]
    lines += [f"| `{room.folder}` | {room.question} |" for room in rooms() if room.modules > 0]
    return "\n".join(lines)

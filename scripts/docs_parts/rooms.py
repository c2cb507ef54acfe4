"""The packages of the product: their order by import-linter, questions and imports."""

__all__ = ["Room", "imported_rooms", "layer_order", "rooms", "table"]

import ast
import tomllib
from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from house.import_cycles import imports_of
from house.repository import PythonFile, Repository, module_name

ROOT = Path(__file__).parents[2]


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
def layer_order() -> tuple[str, ...]:
    """Return the packages and modules that the layers of import-linter name, lowest first."""
    config = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    layers: dict[str, list[str]] = {}
    for contract in config["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers":
            container = contract.get("containers", [""])[0]
            names = [
                part.strip()
                for layer in reversed(contract["layers"])
                for part in layer.replace("|", ":").split(":")
            ]
            prefix = f"{container}." if container else ""
            layers[container] = [prefix + name for name in names]
    order: list[str] = []

    def visit(name: str) -> None:
        for inner in layers.get(name, ()):
            visit(inner)
        if name:
            order.append(name)

    visit("")
    return tuple(order)


@cache
def _product() -> dict[str, PythonFile]:
    """Return the files of the product by the names of their modules."""
    return {module_name(file.path): file for file in Repository(ROOT).product}


@cache
def rooms() -> tuple[Room, ...]:
    """Return every room, lowest first; packages that layers do not name follow their parent."""
    files = _product()
    packages = {name: file for name, file in files.items() if _is_package(file)}
    order = {name: number for number, name in enumerate(layer_order())}

    def named(name: str) -> int:
        while name not in order:
            name = name.rpartition(".")[0]
        return order[name]

    sharing = Counter(map(named, packages))

    def rank(name: str) -> tuple[int, int, str]:
        place = named(name)
        if sharing[place] == 1:
            return place, 0, name
        # A room stands above its sub-rooms, except above one that imports it.
        depth = name.count(".")
        return place, depth if _imports_parent(name, files) else -depth, name

    return tuple(_room(name, packages[name], files) for name in sorted(packages, key=rank))


def _room(name: str, file: PythonFile, files: dict[str, PythonFile]) -> Room:
    members = [
        module
        for module in files
        if module.rpartition(".")[0] == name and not _is_package(files[module])
    ]
    question = (ast.get_docstring(file.tree) or "").partition("\n")[0]
    return Room(name, file.path.removesuffix("/__init__.py"), question, len(members))


def _imports_parent(name: str, files: dict[str, PythonFile]) -> bool:
    """Return whether a module of the room imports a module directly in the parent room."""
    parent = name.rpartition(".")[0]
    members = [module for module in files if module.rpartition(".")[0] == name]
    targets = {target for module in members for target in imports_of(module, files[module], files)}
    return any(
        target.rpartition(".")[0] == parent and not _is_package(files[target]) for target in targets
    )


def _is_package(file: PythonFile) -> bool:
    return file.path.endswith("/__init__.py")


@cache
def imported_rooms() -> dict[str, frozenset[str]]:
    """Return for each room the other rooms that its modules import."""
    files = _product()
    names = {room.name for room in rooms()}

    def room_of(module: str) -> str:
        while module not in names:
            module = module.rpartition(".")[0]
        return module

    imported: defaultdict[str, set[str]] = defaultdict(set)
    for name, file in files.items():
        # A door imports what it opens to, under TYPE_CHECKING; gsgen.__main__ is in no room.
        if _is_package(file) or name == "gsgen.__main__":
            continue
        for target in imports_of(name, file, files):
            if room_of(target) != room_of(name):
                imported[room_of(name)].add(room_of(target))
    return {name: frozenset(targets) for name, targets in imported.items()}


def table() -> str:
    """Return a table of all rooms with modules: folder and question, lowest first."""
    lines = ["| room | its question |", "|---|---|"]
    lines += [f"| `{room.folder}` | {room.question} |" for room in rooms() if room.modules > 0]
    return "\n".join(lines)

"""The walks and the page of the first modules name modules that exist; walks in their order."""

import re
import tomllib
from functools import cache
from itertools import pairwise

import pytest

from support.commands import ROOT
from support.reports.pages import DOCS

WALKS = ("how-a-frame-is-made", "how-a-file-is-validated")
_MODULE = re.compile(r"`((?:contract|sdk|runtime|reference_plugins)/[\w/]+\.py)`")


def legs(name: str) -> list[list[str]]:
    """Return the modules of each table of a walk: down to the data, and up again."""
    text = (DOCS / "guides" / f"{name}.md").read_text("utf-8")
    return [_MODULE.findall(section) for section in text.split("\n## ")[1:3]]


@cache
def layers() -> dict[str, list[list[str]]]:
    """Return the layers that import-linter holds in each package, lowest first."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    return {
        contract.get("containers", [""])[0]: [
            [name.strip() for name in re.split("[|:]", layer)]
            for layer in reversed(contract["layers"])
        ]
        for contract in project["tool"]["importlinter"]["contracts"]
        if contract["type"] == "layers"
    }


def rank(path: str) -> tuple[int, ...]:
    """Return the layer of a module's package, then its layer in there, as deep as layers go."""
    parts = path.removesuffix(".py").split("/")[1:]
    package = ".".join(parts[:2])
    ranks = [_layer_of(package, "")]
    for part in parts[2:]:
        if package not in layers():
            break
        ranks.append(_layer_of(part, package))
        package = f"{package}.{part}"
    return tuple(ranks)


def _layer_of(name: str, container: str) -> int:
    matches = [index for index, names in enumerate(layers()[container]) if name in names]
    assert len(matches) == 1, f"{name} is in {len(matches)} layers of {container or 'the house'}"
    return matches[0]


def is_above(first: str, second: str) -> bool:
    """Return whether the layer of ``first`` is higher; modules of one room are not ordered."""
    rank_pairs = list(zip(rank(first), rank(second), strict=False))
    return [a for a, _ in rank_pairs] > [b for _, b in rank_pairs]


@pytest.mark.parametrize("name", WALKS)
def test_every_module_of_a_walk_exists(name: str) -> None:
    text = (DOCS / "guides" / f"{name}.md").read_text("utf-8")
    modules = _MODULE.findall(text)
    assert len(modules) > 30
    assert len(modules) == len(set(modules)) == sum(map(len, legs(name)))
    assert [path for path in modules if not (ROOT / path).is_file()] == []
    assert len(text.splitlines()) < 150


def test_the_page_of_the_first_modules_names_fifteen_and_other_files_that_exist() -> None:
    text = (DOCS / "start-here.md").read_text("utf-8")
    rows = re.findall(r"^\| (\d+) \| `([\w/]+\.py)` \|", text, re.MULTILINE)
    assert [int(number) for number, _ in rows] == list(range(1, 16))
    modules = {module for _, module in rows}
    assert len(modules) == 15
    others = set(re.findall(r"`([\w/]+\.py)`", text)) - modules
    renderer = ROOT / "runtime/gsgen/runtime"
    paths = [*map(ROOT.joinpath, modules)]
    paths += [
        (ROOT if path.startswith(("sdk/", "runtime/")) else renderer) / path for path in others
    ]
    assert [path for path in paths if not path.is_file()] == []


@pytest.mark.parametrize("name", WALKS)
def test_a_walk_goes_down_the_rooms_and_up_again(name: str) -> None:
    down, up = legs(name)
    assert [(a, b) for a, b in pairwise(down) if is_above(b, a)] == []
    assert [(a, b) for a, b in pairwise(up) if is_above(a, b)] == []


@pytest.mark.parametrize("name", WALKS)
def test_each_direction_of_a_walk_crosses_four_layers(name: str) -> None:
    for leg in legs(name):
        changes = [(a, b) for a, b in pairwise(leg) if rank(a) != rank(b)]
        assert len(changes) >= 4


def test_layer_order_distinguishes_rooms() -> None:
    renderer = "runtime/gsgen/runtime/renderer/renderer.py"
    kernel = "runtime/gsgen/runtime/kernels/sort/sort.py"
    assert is_above(renderer, kernel)
    assert not is_above(kernel, renderer)
    assert not is_above(kernel, "runtime/gsgen/runtime/kernels/raster/draw_quads.py")
    assert is_above(kernel, "runtime/gsgen/runtime/kernels/project/project.py")

"""Links lead somewhere, and lists are complete."""

from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
import yaml

import gsgen
from gsgen.cli.command_table import PANELS
from gsgen.sdk.passes.registry import REWRITES
from gsgen.tiles.validation.rules import all_rules
from support.commands import ROOT, gsgen_here
from support.reports.pages import DOCS, README, anchors, links, name_of, pages

GUIDES = sorted((DOCS / "guides").glob("*.md"))
MOST_GUIDE_WORDS = 27_000


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_every_relative_link_leads_to_a_file_and_a_heading(page):
    for link in links(page):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = link.partition("#")
        target_path = (page.parent / path).resolve() if path else page
        assert target_path.is_file(), f"{name_of(page)}: {link}"
        if page != README:  # the site has what is below docs/ and nothing else
            assert target_path.is_relative_to(DOCS), f"{name_of(page)}: {link}"
        if anchor:
            assert anchor in anchors(target_path), f"{name_of(page)}: {link}"


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_no_page_is_a_dead_end(page: Path) -> None:
    """Its text leads to three other pages, navigation aside."""
    others = {link.partition("#")[0] for link in links(page)} - {""}
    assert len(others) >= 3, sorted(others)


def test_every_rule_is_listed_and_has_a_page():
    listed = set(links(DOCS / "rules" / "index.md"))
    assert listed == {f"{rule.id}.md" for rule in all_rules().rules.values()}


@pytest.mark.parametrize("page", [README, DOCS / "commands.md"], ids=name_of)
def test_every_command_is_described(page):
    text, shown = page.read_text("utf-8"), gsgen_here("--help").out
    for name in (entry.name for panel in PANELS.values() for entry in panel):
        assert f" {name} " in shown
        assert f"`gsgen {name}" in text, f"{name_of(page)} does not describe {name}"


def test_every_page_can_be_reached():
    """From README, by following links; rules and passes are reached through their index."""
    reachable_pages, todo = set(), [README, DOCS / "index.md"]
    while todo:
        page = todo.pop()
        if page in reachable_pages or page.suffix != ".md":
            continue
        reachable_pages.add(page)
        link_targets = (link.partition("#")[0] for link in links(page) if "://" not in link)
        todo += [
            (page.parent / target_path).resolve() for target_path in link_targets if target_path
        ]
    assert reachable_pages >= set(pages())


def test_every_page_of_the_navigation_exists():
    text = (ROOT / "mkdocs.yml").read_text("utf-8")
    named = [file for file in _files(yaml.safe_load(text)["nav"]) if "://" not in file]
    assert len(named) == len(set(named))
    on_site = {page.relative_to(DOCS).as_posix() for page in pages() if page != README}
    rules = {
        f"rules/{rule.id}.md" for rule in all_rules().rules.values()
    }  # found through their index
    passes = {f"passes/{rewrite.name}.md" for rewrite in REWRITES}
    assert set(named) == on_site - rules - passes


def _files(entry: object) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    inner = entry.values() if isinstance(entry, dict) else entry
    assert not isinstance(inner, (int, float))
    return [file for entry in inner for file in _files(entry)]  # type: ignore[attr-defined]


def _visible_lines(page: Path) -> list[str]:
    lines = page.read_text("utf-8").splitlines()
    return [line.removeprefix("::: ") for line in lines if line.startswith("::: ")]


@pytest.mark.parametrize(
    "name",
    [
        "contract",
        "conformance",
        "conformance.fixtures",
        "sdk",
        "sdk.binding",
        "sdk.math",
        "formats",
        "runtime",
        "tiles",
    ],
)
def test_every_public_name_is_on_its_page(name):
    shown = set()
    for path in _visible_lines(DOCS / "api" / f"{name.partition('.')[0]}.md"):
        module, _, last = path.rpartition(".")
        actual = getattr(import_module(module), last)
        # A page may show a module as a whole.
        shown |= {last, *(actual.__all__ if isinstance(actual, ModuleType) else ())}
    assert set(import_module(f"gsgen.{name}").__all__) <= shown


def test_the_front_door_is_on_its_page() -> None:
    shown = {path.rpartition(".")[2] for path in _visible_lines(DOCS / "api" / "gsgen.md")}
    assert shown == {*gsgen.__all__} - {"__version__"}


def test_no_name_is_on_two_places_of_a_page():
    for page in (DOCS / "api").iterdir():
        assert len(_visible_lines(page)) == len(set(_visible_lines(page))), name_of(page)


@pytest.mark.parametrize("page", sorted((DOCS / "api").iterdir()), ids=name_of)
def test_every_name_on_a_page_exists(page):
    for path in _visible_lines(page):
        module, _, name = path.rpartition(".")
        try:
            assert hasattr(import_module(module), name), path
        except ModuleNotFoundError:
            pytest.fail(f"{path} does not exist")


def test_guides_stay_short() -> None:
    """Code and tables included."""
    counts = {page.stem: len(page.read_text("utf-8").split()) for page in GUIDES}
    assert sum(counts.values()) <= MOST_GUIDE_WORDS, sorted(counts, key=counts.__getitem__)[-3:]

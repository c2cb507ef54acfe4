"""A page for each plugin: its picture, what goes in, what is read, options, what is lost, limits."""

import inspect
import io
import re
from collections.abc import Callable

import pytest
from PIL import Image
from typer.models import OptionInfo

from gsgen.cli.commands.exporting.plugin_function import plugin_function
from gsgen.sdk.plugins.plugin import Plugin, find_plugins
from support.reports.pages import DOCS

PAGES = DOCS / "plugins"
PICTURES = DOCS / "assets" / "plugins"
MAX_PICTURE_BYTES = 40_000  # bytes
SECTIONS = ("Inputs", "Input files", "Options", "Ignored data", "Known limits")
BUILT_IN_PLUGINS = sorted(
    name for name, plugin in find_plugins().items() if plugin.point.value.startswith("gsgen.")
)


def text_of(name: str) -> str:
    return (PAGES / f"{name}.md").read_text("utf-8")


def test_every_plugin_has_a_page_and_a_picture() -> None:
    pages = {path.stem for path in PAGES.glob("*.md")} - {"index"}
    assert pages == {path.stem for path in PICTURES.glob("*.jpg")} == set(BUILT_IN_PLUGINS)


@pytest.mark.parametrize("name", BUILT_IN_PLUGINS)
def test_the_page_shows_its_picture_which_is_small(name: str) -> None:
    shown, *others = re.findall(r"^!\[(.+)\]\((\S+)\)$", text_of(name), re.MULTILINE)
    assert shown[1] == f"../assets/plugins/{name}.jpg"
    for expected_message, array in (shown, *others):
        assert len(expected_message) > 20  # says what can be seen, to those who cannot see it
        data = (PAGES / array).read_bytes()
        assert len(data) <= MAX_PICTURE_BYTES
        with Image.open(io.BytesIO(data)) as picture:
            assert picture.format == "JPEG"
            assert picture.size == (1440, 240)
            levels = picture.convert("L").getextrema()
            assert levels[1] - levels[0] > 100, "there is hardly anything to see"


@pytest.mark.parametrize("name", BUILT_IN_PLUGINS)
def test_the_page_has_every_section_and_something_in_each(name: str) -> None:
    parts = re.split(r"^## (.+)$", text_of(name), flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    for section in SECTIONS:
        assert sections.get(section, "").strip(), f"{name} says nothing of {section}"
    if name not in {"static", "sequence", "denoiser"}:  # those are of no one paper
        assert "arxiv.org/abs/" in parts[0] or "code: " in parts[0]


@pytest.mark.parametrize("name", BUILT_IN_PLUGINS)
def test_the_page_names_every_option_of_its_command(name: str) -> None:
    text = text_of(name)
    missing = [option for option in options_of(plugin_of(name)) if option not in text]
    linked = {
        "r3-avatar": "gauhuman",
        "octree-gs": "scaffold-gs",
        "duplex-gs": "scaffold-gs",
        "lhm": "gauhuman",
    }
    if name in linked:  # shared options are on the page that it sends to
        assert f"]({linked[name]}.md#" in text
        missing = [option for option in missing if option not in text_of(linked[name])]
    assert not missing


def plugin_of(name: str) -> Plugin:
    loaded = find_plugins()[name].load()
    assert isinstance(loaded, Plugin)
    return loaded


def options_of(plugin: Plugin) -> list[str]:
    """Return what is typed for each option, but for those that every export has."""
    if plugin.build is not None:
        return option_names(plugin.build)
    example = plugin_of("stylise")
    assert example.build is not None
    shared_options = set(option_names(plugin_function(example))) - set(option_names(example.build))
    return [
        option for option in option_names(plugin_function(plugin)) if option not in shared_options
    ]


def option_names(function: Callable[..., object]) -> list[str]:
    """Return a function's options as typed: of a switch that is on, what turns it off."""
    results = []
    for parameter in inspect.signature(function).parameters.values():
        message = getattr(parameter.annotation, "__metadata__", ())
        info = next((entry for entry in message if isinstance(entry, OptionInfo)), None)
        if info is not None:  # typer takes the first spelling for a default until it is used
            written = " ".join(map(str, (info.default, *(info.param_decls or ()))))
            words = [word for word in written.replace("/", " ").split() if word[:2] == "--"]
            results.append((words or [f"--{parameter.name.replace('_', '-')}"])[-1])
    assert results
    return results


@pytest.mark.parametrize("name", BUILT_IN_PLUGINS)
def test_every_plugin_has_a_demo(name: str) -> None:
    assert plugin_of(name).demo is not None


@pytest.mark.parametrize("name", BUILT_IN_PLUGINS)
def test_the_page_cites_what_the_plugin_cites(name: str) -> None:
    publication, introduction = (plugin_of(name).publication, text_of(name).partition("\n## ")[0])
    cited_papers = re.findall(r"arxiv\.org/abs/([\d.]+)\)", introduction)
    assert cited_papers == [publication.arxiv] * bool(publication.arxiv)
    facts = (publication.paper, publication.code.removeprefix("https://github.com/"))
    for fact in (*facts, publication.licence):
        assert fact in introduction

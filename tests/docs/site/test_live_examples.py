"""The page of live examples shows what its script puts into the site."""

import ast
import re
from html.parser import HTMLParser

import pytest

from support.commands import ROOT

pytestmark = pytest.mark.slow


_PAGE = (ROOT / "docs/live-examples.md").read_text("utf-8")


class _Elements(HTMLParser):
    """Collects the attributes of elements by their tag."""

    def __init__(self) -> None:
        super().__init__()
        self.attributes: dict[str, list[dict[str, str | None]]] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes.setdefault(tag, []).append(dict(attrs))


def written_models() -> tuple[str, ...]:
    """Return the constant MODELS of the script, which needs a browser's runtime to be imported."""
    tree = ast.parse((ROOT / "scripts/write_live.py").read_text("utf-8"))
    [value] = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "MODELS"
    ]
    return tuple(ast.literal_eval(value))


def test_every_example_is_a_model_that_the_script_writes() -> None:
    elements = _Elements()
    elements.feed(_PAGE)
    models = elements.attributes["gsgen-model"]
    assert sorted(str(model["src"]) for model in models) == [
        f"live/{name}" for name in sorted(written_models())
    ]
    assert all(len(str(model["alt"])) > 10 for model in models)
    [script] = elements.attributes["script"]
    assert script == {"type": "module", "src": "live/gsgen/gsgen.js"}


def test_the_site_is_built_with_its_examples() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    docs = re.search(r"^docs: .*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert docs is not None
    assert "scripts/write_live.py site" in docs[1].splitlines()[-1]

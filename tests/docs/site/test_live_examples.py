"""The page of live examples shows what its script puts into the site."""

import ast
import importlib.util
import os
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from gsgen.runtime.web.onnxruntime_web import ORT_FILES, cached_ort
from support.browser import serving
from support.commands import ROOT
from support.web.pages import chromium

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
    models = elements.attributes["gsgen-model"] + elements.attributes["gsgen-scene"]
    assert len(models) == 5
    assert sorted(str(model["src"]) for model in models) == [
        f"live/{name}" for name in sorted(written_models())
    ]
    assert all(len(str(model["alt"])) > 10 for model in models)
    modules, script = elements.attributes["script"]
    assert modules == {"type": "importmap"}
    assert script == {"type": "module", "src": "live/gsgen/scene.js"}


def test_the_site_is_built_with_its_examples() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    docs = re.search(r"^docs: .*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert docs is not None
    assert "scripts/write_live.py site" in docs[1].splitlines()[-1]


def test_every_example_is_drawn(tmp_path: Path) -> None:
    """The page's own elements, with the files that the script writes."""
    if not all((cached_ort() / name).is_file() for name in ORT_FILES):
        missing = pytest.fail if os.environ.get("CI") else pytest.skip
        missing("missing: ONNX Runtime Web; hint: make ort")
    spec = importlib.util.spec_from_file_location("write_live", ROOT / "scripts/write_live.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.write_live(tmp_path)
    elements = re.findall(r'^(?:<script type="module".*</script>|<gsgen-.*)$', _PAGE, re.M)
    style = (
        "<style>gsgen-model, gsgen-scene { width: 120px; height: 90px; aspect-ratio: auto }</style>"
    )
    contents = {"/page.html": f"<!doctype html>{style}{''.join(elements)}".encode()}
    with chromium() as browser, serving({"live": tmp_path / "live"}, contents) as address:
        context = browser.new_context(
            viewport={"width": 640, "height": 480}, reduced_motion="reduce"
        )
        page = context.new_page()
        page.set_default_timeout(240_000)
        page.goto(f"{address}/page.html")
        shown = "[...document.querySelectorAll('gsgen-model, gsgen-scene')]"
        page.wait_for_function(f"{shown}.length === 5 && {shown}.every(({{ report }}) => report)")
        assert page.evaluate(f"{shown}.flatMap(({{ report }}) => report.errors)") == []
        page.wait_for_timeout(2000)
        page.screenshot(path=str(tmp_path / "examples.png"))

"""The tutorial notebook: each cell runs, in order, in an empty folder, and shows its last value."""

import ast
import base64
import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from support.reports.pages import DOCS

pytestmark = pytest.mark.slow


NOTEBOOK = json.loads((DOCS / "tutorial.ipynb").read_text("utf-8"))


def execute(source: str, namespace: dict[str, Any]) -> object:
    """Run a cell as a kernel does, and return the value of its last expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<cell>", "exec"), namespace)
    if last is None:
        return None
    return eval(compile(ast.Expression(last.value), "<cell>", "eval"), namespace)


def picture_of(value: object) -> np.ndarray | None:
    """Return the picture that a notebook shows of a value."""
    if (png := getattr(value, "_repr_png_", lambda: None)()) is not None:
        return np.asarray(Image.open(io.BytesIO(png)))
    html = getattr(value, "_repr_html_", lambda: "")()
    _, sign, data = html.partition("data:image/png;base64,")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))) if sign else None


def test_every_cell_runs_in_an_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "tutorial"}
    pictures, tables = 0, 0
    for cell in NOTEBOOK["cells"]:
        if cell["cell_type"] != "code":
            continue
        value = execute("".join(cell["source"]), namespace)
        picture = picture_of(value)
        if picture is not None:
            pictures += 1
            assert picture[..., :3].std() > 5  # something is drawn
        tables += hasattr(value, "_repr_html_")
    assert (pictures, tables) == (4, 3)


def test_the_notebook_is_saved_without_outputs() -> None:
    assert NOTEBOOK["nbformat"] == 4
    cells = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
    assert len(cells) >= 6
    assert [cell for cell in cells if cell["outputs"] or cell["execution_count"]] == []
    identifiers = [cell["id"] for cell in NOTEBOOK["cells"]]
    assert len(set(identifiers)) == len(identifiers)


def test_the_page_shows_what_these_cells_show() -> None:
    """The stored outputs are of the code as it is; else run `make tutorial`."""
    outputs = json.loads((DOCS / "assets/tutorial/outputs.json").read_text("utf-8"))
    code = ""
    for cell in NOTEBOOK["cells"]:
        if cell["cell_type"] == "code":
            code += "".join(cell["source"])
            digest = hashlib.sha256(code.encode()).hexdigest()[:16]
            assert outputs[cell["id"]]["digest"] == digest, cell["id"]

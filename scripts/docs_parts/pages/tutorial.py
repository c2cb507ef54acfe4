"""The tutorial as a page: the cells of the notebook, with what they show."""

import hashlib
import json
import re
from pathlib import Path
from typing import Any, Final

_DOCS = Path(__file__).parents[3] / "docs"
OUTPUTS: Final = _DOCS / "assets" / "tutorial" / "outputs.json"
"""What the cells show, by their ids: a text, the name of a picture, and the digest of their code."""


def cells() -> list[dict[str, Any]]:
    """Return the cells of the notebook, each with its ``digest``: of its code and of all before."""
    document = json.loads((_DOCS / "tutorial.ipynb").read_text("utf-8"))
    code, result = "", []
    for cell in document["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "code":
            code += source
        digest = hashlib.sha256(code.encode()).hexdigest()[:16]
        result.append({**cell, "source": source, "digest": digest})
    return result


def text_of(value: object, printed: str) -> str:
    """Return what the page shows of a cell without a picture; how many rules there are changes."""
    text = printed.strip() or ("" if value is None else str(value))
    return re.sub(r": [\d,]+ rules hold.*", "", text)


def page() -> str:
    """Return the page; the outputs are those that `make tutorial` stored."""
    outputs = json.loads(OUTPUTS.read_text("utf-8"))
    parts = []
    for cell in cells():
        if cell["cell_type"] == "markdown":
            parts.append(cell["source"])
            continue
        parts.append(f"```python\n{cell['source']}\n```")
        shown = outputs.get(cell["id"], {})
        if text := shown.get("text"):
            parts.append(f"```text\n{text}\n```")
        if picture := shown.get("picture"):
            parts.append(
                f"![What the cell above shows]({OUTPUTS.parent.relative_to(_DOCS)}/{picture})"
            )
    parts.append(
        "This page is [a notebook](tutorial.ipynb): download it, and run it with Jupyter. "
        "[Your first plugin](guides/your-first-plugin.md) goes on; [Quickstart](quickstart.md) has "
        "the same as commands."
    )
    return "\n\n".join(parts) + "\n"

"""Pages on rewrites, from their docstrings."""

import inspect
import re

from gsgen.sdk.passes.framework.base import Rewrite
from gsgen.sdk.passes.registry import REWRITES

_PICTURE = re.compile(r":?:\n\n((?:    .*\n|\n)+)")
_INTRODUCTION = """\
# Passes

`gsgen rewrite` and `gsgen export` run these passes, from the first to the last, in rounds until none changes anything. `gsgen rewrite` proves them by running the model: after the passes that keep every bit, and again after all, it computes the probes of the contract, and a difference beyond what the passes declare stops the rewrite before anything is written. An export is compared with eager torch instead. Chosen are those that the target wants; `core` means every consumer that is known. `--pass NAME` runs one alone, `--skip NAME` leaves one out.

Exactness is that of outputs: *bit for bit* (zeros of either sign, and NaNs, count as equal), or an error as a share of the largest number in the same column of an output.

| pass | what it does | exactness | wanted by |
|---|---|---|---|
"""

_LINKS = (
    "[All passes](index.md) · [Why does capture fail?](../guides/why-does-capture-fail.md) · "
    "[gsgen rewrite](../commands.md#gsgen-rewrite)"
)


def page(rewrite: type[Rewrite]) -> str:
    """Return the Markdown page of a pass."""
    first, _, body = inspect.cleandoc(rewrite.__doc__ or "").partition("\n")
    facts = f"- exactness: {rewrite.exactness.describe()}\n- wanted by: {marked(rewrite.wanted_by)}"
    run = f"gsgen rewrite model.onnx -o out.onnx --pass {rewrite.name}"
    return (
        f"# {rewrite.name}\n\n{marked(first)}\n\n{facts}\n\n"
        f"## Why\n\n{pictured(body.strip())}\n\n"
        f"## Run it alone\n\n```bash\n{run}\n```\n\n---\n\n{_LINKS}\n"
    )


def index() -> str:
    """Return the list of all passes, in the order they run."""
    rows = [
        f"| [{rewrite.name}]({rewrite.name}.md) | {marked(rewrite.summary())} | {rewrite.exactness.describe()} | {marked(rewrite.wanted_by)} |"
        for rewrite in REWRITES
    ]
    return _INTRODUCTION + "\n".join(rows) + "\n"


def marked(text: str) -> str:
    """Convert the markup of a docstring to Markdown."""
    unquoted = re.sub(r":[a-z]+:`~?([^`]+)`", r"`\1`", text)
    return unquoted.replace("``", "`").replace("|", "\\|")


def pictured(text: str) -> str:
    """Fence the pictures of a docstring, and join the lines of its paragraphs."""
    fenced = _PICTURE.sub(_fenced, text + "\n")
    parts = re.split(r"(```text\n.*?```)", fenced, flags=re.DOTALL)
    return "".join(part if part.startswith("```") else _flowing(part) for part in parts).strip()


def _fenced(match: "re.Match[str]") -> str:
    picture = inspect.cleandoc("\n" + match[1])
    return f":\n\n```text\n{picture}\n```\n\n"


def _flowing(text: str) -> str:
    """Join the lines of each paragraph, except those of lists."""
    paragraphs = [
        part if part.lstrip().startswith(("*", "-")) else " ".join(part.split("\n"))
        for part in text.split("\n\n")
    ]
    return marked("\n\n".join(paragraphs)).replace("\\|", "|")

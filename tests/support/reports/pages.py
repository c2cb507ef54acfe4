"""The documentation as tests read it: pages, marked code blocks, headings, links."""

import re
from dataclasses import dataclass
from pathlib import Path

from support.commands import ROOT

DOCS = ROOT / "docs"
README = ROOT / "README.md"

_BLOCK = re.compile(
    r"^<!-- test: (?P<mark>[^>\n]+?) -->\n```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
_FENCED = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"(?<!!)\[(?:[^\[\]]|`[^`]*`)*\]\(([^)\s]+)\)")


@dataclass(frozen=True, slots=True)
class Block:
    """A code block that a test looks at.

    Attributes:
        mark: What the comment in front of it says, such as ``drift.py``.
        language: What stands behind the fence.
        text: The code.
    """

    mark: str
    language: str
    text: str


def pages() -> list[Path]:
    """Return README and every page of the documentation."""
    return [README, *sorted(DOCS.rglob("*.md"))]


def name_of(page: Path) -> str:
    """Return what a test calls a page."""
    return str(page.relative_to(ROOT))


def blocks(page: Path) -> list[Block]:
    """Return the marked code blocks of a page, in order."""
    return blocks_of(page.read_text("utf-8"))


def blocks_of(text: str) -> list[Block]:
    """Return the marked code blocks of a part of a page, in order."""
    matches = _BLOCK.finditer(text)
    return [Block(entry["mark"], entry["language"], entry["text"]) for entry in matches]


def links(page: Path) -> list[str]:
    """Return what the links of a page point to, code blocks aside."""
    return _LINK.findall(_FENCED.sub("", page.read_text("utf-8")))


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page: of its headings, as the site and GitHub make them, and its own."""
    text = _FENCED.sub("", page.read_text("utf-8"))
    headings = re.findall(r"^#{1,6} +(.+?)\s*$", text, re.MULTILINE)
    return {_slug(heading) for heading in headings} | set(re.findall(r'<a id="([^"]+)"', text))


def _slug(heading: str) -> str:
    original = re.sub(r"[^\w\s-]", "", heading).strip().lower()
    return re.sub(r"[-\s]+", "-", original)

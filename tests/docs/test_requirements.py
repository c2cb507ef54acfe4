"""Each sentence of the specification with *must* or *should* is tied to a rule of that severity."""

import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from gsgen.contract.spec.severity import Severity
from gsgen.tiles.validation.rules import all_rules

SPEC = Path(__file__).parents[2] / "docs" / "spec"
PAGE = SPEC / "requirements.md"
SEVERITIES = {"must": Severity.ERROR, "should": Severity.WARNING}
_WORD = re.compile(r"\b(must|should)\b", re.IGNORECASE)
_RULE = re.compile(r"\b[A-Z]{2}[0-9]{3}\b")
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z`*(])")


@dataclass(frozen=True, slots=True)
class Requirement:
    """A row of the table: a sentence, and the rules that check it or the reason why none can."""

    page: str
    sentence: str
    checked_by: str


def plain(text: str) -> str:
    """Return Markdown without links, emphasis and repeated spaces."""
    text = re.sub(r"\s*\(\[[A-Z]{2}[0-9]{3}\]\([^)]*\)\)", "", text)  # a rule in brackets
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(text.replace("**", "").replace("*", "").split())


def sentences(text: str) -> list[str]:
    """Return the sentences of a page that contain *must* or *should*."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    results = []
    for line in text.splitlines():
        cells = line.strip().strip("|").split(" | ") if line.startswith("|") else [line]
        for cell in cells:
            stripped = re.sub(r"^\s*(?:[-*]|[0-9]+\.)\s+", "", cell)
            results += [s for s in _SENTENCE_END.split(plain(stripped)) if _WORD.search(s)]
    return results


def requirements() -> list[Requirement]:
    """Return the rows of the table."""
    rows = []
    for line in PAGE.read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("| [") and len(cells) == 3:
            page = re.findall(r"\]\(([a-z]+\.md)\)", cells[0])[0]
            rows.append(Requirement(page, plain(cells[1]), cells[2]))
    return rows


PAGES = sorted(path for path in SPEC.glob("*.md") if path != PAGE)
ROWS = requirements()
each_row = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.sentence[:40])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_each_sentence_has_a_row_and_each_row_a_sentence(page: Path) -> None:
    rows = [row.sentence for row in ROWS if row.page == page.name]
    assert sorted(rows) == sorted(sentences(page.read_text("utf-8")))


@each_row
def test_a_rule_has_the_severity_of_its_sentence(row: Requirement) -> None:
    rules = all_rules().rules
    words = {word.lower() for word in _WORD.findall(row.sentence)}
    if plain(row.checked_by).startswith(("no rule: ", "a definition")):
        return
    severities = {SEVERITIES[word] for word in words}
    checked = [rules[id] for id in dict.fromkeys(_RULE.findall(row.checked_by))]
    assert {rule.severity for rule in checked} == severities, (words, row.checked_by)


def test_the_tables_of_the_specification_are_found() -> None:
    text = "A x must. B may.\n\n| a | it should be |\n- **C** must ([GM001](../rules/GM001.md)).\n"
    assert sentences(text) == ["A x must.", "it should be", "C must."]
    assert len(ROWS) >= 30

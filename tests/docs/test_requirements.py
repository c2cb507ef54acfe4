"""Each sentence of the specification is tied to rules of its severity, or says why to none."""

import re
import sys
from pathlib import Path

import pytest

from gsgen.contract.spec.severity import Severity
from gsgen.tiles.validation.rules import all_rules

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from docs_parts.statements import LETTERS, numbered, pages, sentences, statements  # noqa: E402

SPEC = ROOT / "docs" / "spec"
PAGE = SPEC / "requirements.md"
SEVERITIES = {"must": Severity.ERROR, "should": Severity.WARNING}
REASONS = {"a definition", "asks readers", "asks validators", "no file shows it", "a note"}
_WORD = re.compile(r"\b(must|should)\b", re.IGNORECASE)
_RULE = re.compile(r"\b[A-Z]{2}[0-9]{3}\b")
_ROW = re.compile(r"^\| \[([A-Z][0-9]+)\]\(([a-z-]+\.md)#([a-z][0-9]+)\) \| (.*) \|$", re.MULTILINE)
_GROUP = re.compile(r"(?:(?P<first>[0-9]+)(?:–(?P<last>[0-9]+))?: )?(?P<answer>.+)")

STATEMENTS = {page: statements((SPEC / page).read_text("utf-8")) for page in sorted(LETTERS)}
SENTENCES = {number: found for page in STATEMENTS.values() for number, found in page.items()}
ROWS = {number: answer for number, _, _, answer in _ROW.findall(PAGE.read_text("utf-8"))}


def answers(number: str) -> list[str]:
    """Return what the table says of each sentence of a statement."""
    results: list[str] = []
    for text in ROWS[number].split("; "):
        group = _GROUP.fullmatch(text)
        assert group, text
        first = int(group["first"] or 1)
        last = int(group["last"] or group["first"] or len(SENTENCES[number]))
        assert first == len(results) + 1, "sentences are answered in order, without gaps"
        results += [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", group["answer"])] * (last - first + 1)
    return results


@pytest.mark.parametrize("page", sorted(LETTERS))
def test_each_statement_has_a_number_and_a_row(page: str) -> None:
    assert pages(SPEC)[SPEC / page] == (SPEC / page).read_text("utf-8"), "run scripts/write_docs.py"
    rows = [row for row in _ROW.findall(PAGE.read_text("utf-8")) if row[1] == page]
    assert [number for number, *_ in rows] == sorted(STATEMENTS[page], key=lambda x: int(x[1:]))
    assert all(anchor == number.lower() for number, _, anchor, _ in rows)


@pytest.mark.parametrize("number", SENTENCES)
def test_each_sentence_has_an_answer_of_its_severity(number: str) -> None:
    rules = all_rules().rules
    found = answers(number)
    assert len(found) == len(SENTENCES[number])
    for sentence, answer in zip(SENTENCES[number], found, strict=True):
        ids = _RULE.findall(answer)
        assert answer in REASONS or answer == ", ".join(ids), answer
        words = {word.lower() for word in _WORD.findall(sentence)}
        severities = {rules[id].severity for id in ids}
        if words and ids:
            assert severities == {SEVERITIES[word] for word in words}, (sentence, answer)
        if words:
            assert answer != "a note", sentence


def test_each_rule_has_a_statement() -> None:
    cited = {id for answer in ROWS.values() for id in _RULE.findall(answer)}
    assert sorted(all_rules().rules) == sorted(cited)


def test_a_number_stays_with_its_statement() -> None:
    text = "# Layout\n\nA x must. B may.\n\n| a | b |\n\n- **C** ([GM001](../rules/GM001.md)).\n"
    first = numbered(text, "layout.md")
    assert statements(first) == {"L1": ["A x must.", "B may."], "L2": ["C."]}
    moved = first.replace("# Layout\n", "# Layout\n\nNew.\n")
    assert statements(numbered(moved, "layout.md")) == {
        "L3": ["New."], "L1": ["A x must.", "B may."], "L2": ["C."]
    }  # fmt: skip
    without = re.sub(r"\n- .*\n", "\nD.\n", first)
    assert list(statements(numbered(without, "layout.md", frozenset({"L2"})))) == ["L1", "L3"]
    assert sentences("A `b`. **C** [d](e.md).") == ["A `b`.", "C d."]

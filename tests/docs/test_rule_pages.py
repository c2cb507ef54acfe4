"""The pages of rules: short, with an example, and no dead end."""

import re

from gsgen.tiles.validation.rules import all_rules
from support.reports.pages import DOCS, anchors

MOST_WORDS = 90  # beside code, tables, pictures and links
CAPTIONS = ("Left:", "Four frames")
PAGES = [DOCS / "rules" / f"{id}.md" for id in all_rules().rules if "/" not in id]
# The difference is in no line of a model: metadata of a value, a waiver, a promise of the graph.
WITHOUT_CODE = {"GM014", "GW001", "TV104"}


def words_of(text: str) -> list[str]:
    """Return the words of the sentences: what must hold, why, the repair, the evidence."""
    parts = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE).split("\n\n")
    prose = [part for part in parts if part.strip() and part.strip()[0] not in "#*|![-"]
    return [word for part in prose if not part.startswith(CAPTIONS) for word in part.split()]


def test_a_rule_is_told_in_few_words() -> None:
    counts = {
        page.stem: len(words_of(page.read_text("utf-8").partition("\n---\n")[0])) for page in PAGES
    }
    assert {rule: count for rule, count in counts.items() if not 15 < count <= MOST_WORDS} == {}


def test_every_rule_has_bad_and_good_code_or_pictures() -> None:
    shown = re.compile(r"^```diff\n[-+] |^!\[a right scene", re.MULTILINE)
    without = {page.stem for page in PAGES if not shown.search(page.read_text("utf-8"))}
    assert without == WITHOUT_CODE


def test_the_way_back_leads_to_the_family() -> None:
    headings = anchors(DOCS / "rules" / "index.md")
    for page in PAGES:
        anchor = re.search(r"\(index\.md#([\w-]+)\)", page.read_text("utf-8"))
        assert anchor is not None, page
        assert anchor[1] in headings, page

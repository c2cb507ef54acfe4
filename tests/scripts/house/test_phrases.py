"""Banned phrases, and the prose in which they are looked for."""

import pytest
from house.phrases import PHRASES

BANNED = {
    "is none": ["The value is none.", "Distances where none is known."],
    "is no X": ["This is no model.", "They are no splats."],
    "what is": ["Return what is given.", "What was found, in order."],
    "what came of": ["Report what came of it.", "Keep what follows."],
    "as told": ["Draw it as told.", "Written as asked."],
    "whoever": ["Whoever calls it closes it."],
    "whatever": ["Ends, whatever happens."],
    "nobody": ["An input that nobody feeds.", "Somebody waits."],
    "anew": ["Draw the frame anew."],
    "lies beside": ["The manifest lies beside the model."],
    "say whether": ["Say whether it fits.", "The flag tells whether it fits."],
    "mend": ["The way to mend it."],
    "judge": ["Rules that were judged.", "Judge the model."],
}
ALLOWED = [
    "There is no limit.",
    "The key is no longer read.",
    "The field is None.",
    "What is a Gaussian Generator?",
    "Return the result.",
    "The recommended amendment.",
    "Return whether it fits.",
]


def test_every_phrase_has_examples():
    assert set(BANNED) == {phrase.name for phrase in PHRASES}


@pytest.mark.parametrize(("name", "text"), [(n, t) for n, texts in BANNED.items() for t in texts])
def test_a_banned_phrase_is_reported(measure, name, text):
    result = measure("phrases", {"docs/page.md": f"A title\n\n{text}\n"})
    assert [(v.subject, v.path, v.line) for v in result.violations] == [(name, "docs/page.md", 3)]
    assert not result.passed


@pytest.mark.parametrize("text", ALLOWED)
def test_ordinary_english_passes(measure, text):
    assert measure("phrases", {"docs/page.md": text}).violations == []


@pytest.mark.parametrize(
    ("path", "text", "line"),
    [
        ("sdk/a.py", '"""Doc.\n\nDrawn anew.\n"""\n', 3),
        ("sdk/a.py", 'x = 1\nraise ValueError("is drawn anew")\n', 2),
        ("sdk/a.py", 'x = 1\nraise ValueError(f"{x} is no model")\n', 2),
        ("sdk/a.py", "x = 1\n# Drawn\n# anew.\n", 3),
        ("sdk/a.py", "x = 1  # drawn anew\n", 1),
        ("runtime/a.wgsl", "const A = 1;\n// Drawn anew.\n", 2),
        ("README.md", "Frames are\ndrawn anew\n", 2),
        ("docs/deep/page.md", "```python\nx = 1\n```\nDrawn anew\n", 4),
    ],
)
def test_docstrings_messages_comments_shaders_and_pages_are_read(measure, path, text, line):
    result = measure("phrases", {path: text})
    assert [(v.path, v.line) for v in result.violations] == [(path, line)]


def test_a_phrase_over_the_end_of_a_line_is_found(measure):
    (violation,) = measure("phrases", {"docs/a.md": "One. It\nis\n   no model."}).violations
    assert (violation.line, violation.subject) == (2, "is no X")


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("docs/a.md", "The key `mend` and ``drawn anew``."),
        ("docs/a.md", "```text\nis drawn anew\n```\n"),
        ("docs/a.md", "<!-- generated: rules -->\nDrawn anew.\n<!-- end generated -->\n"),
        ("CHANGELOG.md", "Drawn anew."),
        ("tests/test_a.py", '"""Drawn anew."""'),
        ("sdk/a.py", 'KEYS = ["anew"]'),
        ("sdk/a.py", '"""The key ``anew``."""'),
    ],
)
def test_code_names_and_history_are_left_out(measure, path, text):
    assert measure("phrases", {path: text}).violations == []


@pytest.mark.parametrize(("words", "passed"), [(10_000, True), (9_000, False)])
def test_three_phrases_in_ten_thousand_words_pass(measure, words, passed):
    text = "anew " * 3 + "word " * (words - 3)
    result = measure("phrases", {"docs/a.md": text})
    assert result.figure == pytest.approx(30_000 / words)
    assert result.passed is passed

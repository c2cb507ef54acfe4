"""No text leaves with a character that controls a terminal, or with a command of a CI system."""

import json
import os
import shlex
import subprocess
import unicodedata
from html.parser import HTMLParser

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from gsgen.contract import _safe_text as safe

# Characters of every category, and the pieces that attacks are made of.
PIECES = st.one_of(
    st.characters(),
    st.sampled_from(
        ["::", "::error::", "##[error]", "\n", "\r", "\t", " ", "\x1b[2J", "\x9b", "'"]
    ),
    st.sampled_from(
        ["\u202e", "\u2066", "\u200b", "\ufeff", "\u2028", "\u034f", "\ufe0f", "---\n"]
    ),
    st.sampled_from(["<script>", "`", "|", "](x)", "$(id)", "\\", '"', ": ", "- ", "#", "%0A"]),
)
TEXTS = st.lists(PIECES, max_size=12).map("".join)


def controls(text: str, allowed_chars: str = "") -> list[str]:
    """Return the characters of a text that a terminal obeys or does not show."""
    hidden = ("Cc", "Cf", "Cs", "Zl", "Zp")
    invisible = "\u034f\u115f\u1160\u3164\uffa0\ufe0e\ufe0f\U000e0101"
    return [
        c
        for c in text
        if (unicodedata.category(c) in hidden or c in invisible) and c not in allowed_chars
    ]


def commands(text: str) -> list[str]:
    """Return the lines that GitHub runs."""
    lines = text.replace("\r", "\n").split("\n")
    return [line for line in lines if line.lstrip().startswith("::") or "##[" in line]


@given(TEXTS)
def test_printable_text_is_one_line_without_controls(text: str) -> None:
    result = safe.printable(text)
    assert not controls(result)
    assert result == text or controls(text) or not text.isprintable()
    assert safe.printable(result) == result


@given(TEXTS)
def test_terminal_text_keeps_its_lines_alone(text: str) -> None:
    result = safe.for_terminal(text)
    assert not controls(result, "\n\t")
    assert not commands(result)
    assert result.count("\n") == text.count("\n")
    assert safe.for_terminal(result) == result


@given(TEXTS)
def test_text_of_a_github_command_is_one_line_without_commands(text: str) -> None:
    result = safe.without_commands(text)
    assert not controls(result)
    assert not commands(result)


@given(
    st.recursive(TEXTS, lambda value: st.lists(value) | st.dictionaries(TEXTS, value), max_leaves=5)
)
def test_json_text_means_the_same(document: object) -> None:
    for indent in (2, None):
        text = safe.for_json(document, indent=indent)
        assert json.loads(text) == json.loads(json.dumps(document))
        assert not controls(text, "\n")
        assert not commands(text)


@given(TEXTS)
def test_yaml_scalar_is_the_printable_text(text: str) -> None:
    document = yaml.safe_load(f"license: {safe.for_yaml(text)}\ntags: []\n")
    assert document == {"license": safe.printable(text), "tags": []}


class Words(HTMLParser):
    """Collects the text and the tags of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.text, self.tags = "", [("p", [])]

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, attrs))


@given(TEXTS)
def test_html_text_adds_no_element(text: str) -> None:
    parser = Words()
    parser.feed(f'<a title="{safe.for_html(text)}">{safe.for_html(text)}</a>')
    parser.close()
    expected = safe.printable(text, kept_chars="\n")
    assert parser.text == expected
    assert parser.tags[1:] == [("a", [("title", expected)])]


@given(TEXTS)
def test_markdown_text_has_no_markup(text: str) -> None:
    result = safe.for_markdown(text)
    assert not controls(result)
    for mark in "`*_[]<>|":
        assert result.replace("\\\\", "").replace(f"\\{mark}", "").count(mark) == 0


@given(TEXTS.filter(lambda text: text and "\0" not in text and not controls_surrogates(text)))
def test_shell_word_is_the_name_of_the_file(text: str) -> None:
    word = safe.for_shell(text)
    assert not controls(word)
    assert not word.startswith("-")
    if not word.startswith("$'"):
        assert shlex.split(word) == [f"./{text}" if text.startswith("-") else text]


def controls_surrogates(text: str) -> bool:
    return any(unicodedata.category(c) == "Cs" for c in text)


NAMES = [
    "a\nb",
    "-x\t",
    "it's\n",
    "a\\\nb",
    "\x1b[2J",
    "é\u202e",
    "a\x01f",
    "\x9bm",
    "\xad",
    "\udcff\n",
]


@pytest.mark.parametrize("name", NAMES)
def test_shell_word_with_escapes_is_read_back_by_bash(name: str) -> None:
    command = f"printf %s {safe.for_shell(name)}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, env={"LC_ALL": "C.UTF-8"})
    assert os.fsdecode(done.stdout) == (f"./{name}" if name.startswith("-") else name)

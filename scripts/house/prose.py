"""Extracts the prose of the project: docstrings, messages, comments and pages."""

__all__ = ["Passage", "page_passages", "python_passages", "shader_passages", "word_count"]

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass

from house.repository import Page, PythonFile, Shader

_CODE_SPAN = re.compile(r"(`+).+?\1", re.DOTALL)
_CODE_BLOCK = re.compile(r"^[ \t]*(```|~~~).*?^[ \t]*\1[ \t]*$", re.MULTILINE | re.DOTALL)
_GENERATED = re.compile(r"<!-- generated:.*?<!-- end generated -->", re.DOTALL)
_LINK_TARGET = re.compile(r"\]\([^)]*\)")
_WORD = re.compile(r"[A-Za-z][A-Za-z'’-]*")
_MESSAGE = re.compile(r"[A-Za-z]{2,} [A-Za-z]")  # two words: neither a name nor a pattern
_SHADER_COMMENT = re.compile(r"(?:^[ \t]*//(?!!)[^\n]*\n?)+|//(?!!)[^\n]*", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Passage:
    """A passage of prose with its file and line.

    Attributes:
        path: The file, from the root.
        line: Line of the text's first character.
        text: The text, with code replaced by spaces, so that lines can be counted.
    """

    path: str
    line: int
    text: str


def word_count(passages: list[Passage]) -> int:
    """Return the number of words of a text, without code."""
    return sum(len(_WORD.findall(passage.text)) for passage in passages)


def python_passages(file: PythonFile) -> list[Passage]:
    """Return the docstrings, messages and comments of a Python file."""
    return [*_strings(file), *_comments(file)]


def shader_passages(shader: Shader) -> list[Passage]:
    """Return the comments of a shader; consecutive lines are one passage."""
    passages = []
    for match in _SHADER_COMMENT.finditer(shader.text):
        line = shader.text.count("\n", 0, match.start()) + 1
        text = re.sub(r"^[ \t]*//", "", match[0], flags=re.MULTILINE)
        passages.append(Passage(shader.path, line, _without_code(text)))
    return passages


def page_passages(page: Page) -> list[Passage]:
    """Return the prose of a page, without code and parts generated from docstrings."""
    text = page.text
    for pattern in (_GENERATED, _CODE_BLOCK, _LINK_TARGET):
        text = pattern.sub(_blank, text)
    return [Passage(page.path, 1, _without_code(text))]


def _strings(file: PythonFile) -> Iterator[Passage]:
    """Yield every string of several words; the values of an f-string become an ellipsis."""
    parts = {
        id(part)
        for node in file.nodes
        if isinstance(node, ast.JoinedStr)
        for part in ast.walk(node)
        if part is not node
    }
    for node in file.nodes:
        if id(node) in parts:
            continue
        match node:
            case ast.Constant(value=str(text)):
                pass
            case ast.JoinedStr(values=values):
                text = "".join(
                    str(value.value) if isinstance(value, ast.Constant) else "…" for value in values
                )
            case _:
                continue
        if _MESSAGE.search(text):
            yield Passage(file.path, node.lineno, _without_code(text))


def _comments(file: PythonFile) -> Iterator[Passage]:
    """Yield the comments of a Python file; consecutive lines are one passage."""
    first, last, texts = 0, 0, list[str]()
    if "#" not in file.text:
        return
    for token in tokenize.generate_tokens(io.StringIO(file.text).readline):
        if token.type != tokenize.COMMENT:
            continue
        if token.start[0] != last + 1 and texts:
            yield Passage(file.path, first, _without_code("\n".join(texts)))
            texts = []
        first = first if texts else token.start[0]
        last = token.start[0]
        texts.append(token.string.lstrip("#"))
    if texts:
        yield Passage(file.path, first, _without_code("\n".join(texts)))


def _without_code(text: str) -> str:
    return _CODE_SPAN.sub(_blank, text)


def _blank(match: re.Match[str]) -> str:
    """Return a placeholder with as many line ends as the matched text."""
    return "…" + "\n" * match[0].count("\n")

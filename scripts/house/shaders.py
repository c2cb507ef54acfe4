"""Finds shader files that are fragments of another file's function."""

__all__ = ["shaders"]

import re
from collections.abc import Iterator

from house.repository import Repository, Shader
from house.violation import Measurement, Violation

_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_INCLUDE = re.compile(r"^[ \t]*//!include[ \t]+(\S+)[ \t]*$", re.MULTILINE)
_DECLARATION = re.compile(
    r"\s*(?:@|(?:fn|struct|const|override|var|alias|enable|requires|diagnostic|const_assert)\b)"
)


def shaders(repository: Repository) -> Measurement:
    """Find shader files that are not whole WGSL declarations, or are included inside one."""
    violations: list[Violation] = []
    for shader in repository.shaders:
        if repository.selects(shader.path):
            violations += _fragment(shader)
            violations += _included_in_function(shader)
    return Measurement(violations, len(repository.shaders))


def _fragment(shader: Shader) -> Iterator[Violation]:
    """Yield the first text at module level that does not begin a declaration."""
    code = _COMMENT.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), shader.text)
    depth, start = 0, 0
    for offset, character in enumerate(code):
        if character in "{(":
            depth += 1
        elif character in "})":
            depth -= 1
            if depth < 0:
                yield _violation(shader, offset, "a closing bracket without its opening one")
                return
        if depth == 0 and character in ";}":
            declaration = code[start : offset + 1]
            if declaration.strip(" \t\n;") and not _DECLARATION.match(declaration):
                first = start + len(declaration) - len(declaration.lstrip())
                line = declaration.strip().partition("\n")[0]
                yield _violation(shader, first, f"{line!r} outside of every function")
                return
            start = offset + 1
    if depth or code[start:].strip():
        yield _violation(shader, start, "a declaration that does not end in this file")


def _included_in_function(shader: Shader) -> Iterator[Violation]:
    """Yield every include directive inside brackets."""
    for match in _INCLUDE.finditer(shader.text):
        before = _COMMENT.sub("", shader.text[: match.start()])
        if before.count("{") > before.count("}"):
            name = match[1].removesuffix(".wgsl")
            yield Violation(
                path=shader.path,
                line=shader.text.count("\n", 0, match.start()) + 1,
                subject=name,
                actual=f"{name}.wgsl is inserted in the middle of a function",
                expected="includes between declarations only",
                hint=f"make {name}.wgsl a function with parameters, or join it to its only user",
            )


def _violation(shader: Shader, offset: int, actual: str) -> Violation:
    return Violation(
        path=shader.path,
        line=shader.text.count("\n", 0, offset) + 1,
        subject=shader.name,
        actual=actual,
        expected="a file of whole declarations",
        hint="make the text a function with parameters, or join it to its only user",
    )

"""Reads the options of a training run from ``cfg_args``.

The file is one line, ``str(argparse.Namespace)``: ``Namespace(feat_dim=32, eval=True, …)``. The
published loaders pass it to ``eval``; here it is parsed, and only literals are read. A path,
which pathlib prints as ``PosixPath('…')``, becomes its text. Any other value stays the text that
Python printed, and is an error only if a plugin reads that option.
"""

__all__ = ["CfgArgs", "PrintedObject", "read_cfg_args"]

import ast
import keyword
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gsgen.reference_plugins.loading.errors import CheckpointInvalid

_FILE_NAME = "cfg_args"
_MAX_BYTES = 1 << 20
_MAX_SHOWN_CHARACTERS = 80
# The class names in pathlib's printed paths.
_PATH_SETTINGS = frozenset(
    f"{pure_prefix}{kind}Path" for pure_prefix in ("", "Pure") for kind in ("", "Posix", "Windows")
)
# Quoted texts, and printed values that Python cannot parse: objects, as <function main at 0x7f…>,
# and options named like a keyword of Python, as --lambda.
_KEYWORD_PATTERN = "|".join(keyword.kwlist)
_TEXT_OR_NOT_PYTHON = re.compile(
    r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|"""
    rf"(?P<other><[^<>\n]*>|\b(?:{_KEYWORD_PATTERN}|__debug__)(?==))"
)


@dataclass(frozen=True, slots=True)
class PrintedObject:
    """A training option's value that is not a Python literal: kept as text, never evaluated."""

    text: str

    def __repr__(self) -> str:
        return self.text


@dataclass(frozen=True, slots=True)
class CfgArgs:
    """The options of one training run, read from ``cfg_args``."""

    path: Path
    values: dict[str, Any]  # option → literal, or :class:`Printed`; empty if the file is absent
    file_exists: bool = True  # whether the file exists

    def flag(self, name: str, *, default: bool = False) -> bool:
        """Return a boolean training option."""
        value = self.values.get(name, default)
        if not isinstance(value, bool):
            raise self._wrong_value_error(name, "True or False")
        return value

    def integer(self, name: str, default: int) -> int:
        """Return an integer training option."""
        value = self.values.get(name, default)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self._wrong_value_error(name, "a whole number")
        return value

    def number(self, name: str, default: float) -> float:
        """Return a numeric training option as float."""
        value = self.values.get(name, default)
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self._wrong_value_error(name, "a number")
        return float(value)

    def word(self, name: str, default: str, known: Iterable[str] = ()) -> str:
        """Return a text option of the training; raise if it is not one of the known words."""
        value = self.values.get(name, default)
        choices = tuple(known)
        if not isinstance(value, str) or (choices and value not in choices):
            raise self._wrong_value_error(name, " or ".join(map(repr, choices)) or "a word")
        return value

    def printed_objects(self) -> dict[str, PrintedObject]:
        """Return the training options whose values are not literals, and so cannot be read."""
        return {
            name: value for name, value in self.values.items() if isinstance(value, PrintedObject)
        }

    def _wrong_value_error(self, name: str, expected: str) -> CheckpointInvalid:
        actual = repr(self.values[name])[:_MAX_SHOWN_CHARACTERS]
        return CheckpointInvalid(f"{name} is {actual}, expected {expected}", where=str(self.path))


def read_cfg_args(folder: Path, *, required: bool = False) -> CfgArgs:
    """Read the training options from ``cfg_args`` of the training run in ``folder``."""
    path = folder / _FILE_NAME
    if not path.is_file():
        if required:
            hint = f"Copy {_FILE_NAME} from the folder that training wrote: its flags change the result."
            raise CheckpointInvalid("is missing", where=str(path), hint=hint)
        return CfgArgs(path, {}, file_exists=False)
    return CfgArgs(path, _parse_file(path))


def _parse_file(path: Path) -> dict[str, Any]:
    hint = "Expected one line: Namespace(name=literal, …), as the training code writes it."
    if path.stat().st_size > _MAX_BYTES:
        message = f"has {path.stat().st_size:,} bytes, expected at most {_MAX_BYTES:,}"
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    try:
        text = path.read_text("utf-8").strip()
        tree = _parse_expression(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", str(error))
        message = f"cannot be parsed: {reason}"
        raise CheckpointInvalid(message, where=str(path), hint=hint) from error
    if not (
        isinstance(tree, ast.Call)
        and isinstance(tree.func, ast.Name)
        and tree.func.id == "Namespace"
        and not tree.args
        and all(option.arg or _is_unspellable(option.value) for option in tree.keywords)
    ):
        raise CheckpointInvalid("is not a printed Namespace(…)", where=str(path), hint=hint)
    return {name: _literal_value(node, text) for name, node in _options(tree, text)}


def _parse_expression(text: str) -> ast.expr:
    try:
        return ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError):  # a ValueError: Python < 3.11.4 so refuses null characters
        # Replace it by a name of equal length, so that positions in the text stay valid.
        parsable_text = _TEXT_OR_NOT_PYTHON.sub(
            lambda match: "_" * len(match[0].encode()) if match["other"] else match[0], text
        )
        if parsable_text == text:
            raise
        return ast.parse(parsable_text, mode="eval").body


def _is_unspellable(value: ast.expr) -> bool:
    """Return whether a dict expression has only keys that are not Python identifiers."""
    return isinstance(value, ast.Dict) and all(
        isinstance(key, ast.Constant)
        and isinstance(key.value, str)
        and not key.value.isidentifier()
        for key in value.keys
    )


def _options(tree: ast.Call, text: str) -> Iterator[tuple[str, ast.expr]]:
    for option in tree.keywords:
        if option.arg:
            # From the text, because the parser normalises names.
            source = ast.get_source_segment(text, option) or option.arg
            yield source.partition("=")[0].rstrip(), option.value
        elif isinstance(option.value, ast.Dict):
            for key, value in zip(option.value.keys, option.value.values, strict=True):
                assert isinstance(key, ast.Constant)
                yield str(key.value), value


def _literal_value(node: ast.expr, text: str) -> Any:
    source = ast.get_source_segment(text, node) or ""
    try:
        return ast.literal_eval(_LiteralValues().visit(node))
    except (ValueError, TypeError, RecursionError, MemoryError):
        return PrintedObject(source)


class _LiteralValues(ast.NodeTransformer):
    """Rewrites ``inf``, ``nan`` and printed paths in the tree of ``cfg_args`` as literals."""

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Constant(float(node.id)) if node.id in ("inf", "nan") else node

    def visit_Call(self, node: ast.Call) -> ast.expr:
        match node:
            case ast.Call(ast.Name(name), [ast.Constant(str(path))], []) if name in _PATH_SETTINGS:
                return ast.Constant(path)
        return node

"""Converts text of the command line to values of a declared type, without evaluating code."""

__all__ = ["convert", "name_of"]

import enum
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from gsgen.contract.errors import ConfigInvalid

_TRUE_WORDS = frozenset({"1", "on", "true", "yes"})
_FALSE_WORDS = frozenset({"0", "false", "no", "off"})
_SEQUENCE_TYPES = (list, tuple, Sequence)


def convert(text: str, annotation: Any, where: str) -> Any:
    """Convert text from the command line to a value of a parameter's declared type.

    Types: ``str``, ``int``, ``float``, ``bool``, ``Path``, an Enum, a Literal, a union, or a list
    or tuple of those (separated by commas). ``where`` names the option in an error.
    """
    try:
        return _convert_argument(text, annotation)
    except ValueError as error:
        message = f"{text!r} is not {_describe_type(annotation)}"
        raise ConfigInvalid(message, where=where) from error
    except TypeError as error:
        message = f"{name_of(annotation)} cannot be written on a command line"
        hint = "Give the parameter a default, or write a factory that takes texts."
        raise ConfigInvalid(message, where=where, hint=hint) from error


def _convert_argument(text: str, annotation: Any) -> Any:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _convert_argument(text, get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return _parse_first_match(text, get_args(annotation))
    if origin is Literal:
        return _choose_value(text, {str(value): value for value in get_args(annotation)})
    if origin in _SEQUENCE_TYPES or annotation in _SEQUENCE_TYPES:
        return _convert_sequence(text, origin or annotation, get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        member_by_value = {str(member.value): member for member in annotation}
        return _choose_value(text, member_by_value | {member.name: member for member in annotation})
    simple_parsers: dict[Any, Callable[[str], Any]] = {
        Any: str,
        Path: Path,
        bool: _parse_boolean,
        float: float,
        int: int,
        object: str,
        str: str,
        type(None): _parse_none,
    }
    if annotation not in simple_parsers:
        raise TypeError
    return simple_parsers[annotation](text)


def _parse_first_match(text: str, members: Sequence[Any]) -> Any:
    """Convert text by the first matching member of a union; str comes last since it always fits."""
    for member in sorted(members, key=lambda member_type: member_type in (str, Path, Any)):
        try:
            return _convert_argument(text, member)
        except (TypeError, ValueError):
            continue
    raise ValueError


def _convert_sequence(text: str, kind: Any, members: Sequence[Any]) -> Any:
    items = [word.strip() for word in text.split(",")] if text else []
    is_fixed_length = kind is tuple and members and members[-1] is not Ellipsis
    if is_fixed_length and len(items) != len(members):
        raise ValueError
    member_types = members if is_fixed_length else [members[0] if members else str] * len(items)
    values = [
        _convert_argument(word, element_type)
        for word, element_type in zip(items, member_types, strict=True)
    ]
    return tuple(values) if kind is tuple else values


def _choose_value(text: str, choices: dict[str, Any]) -> Any:
    if text not in choices:
        raise ValueError
    return choices[text]


def _parse_boolean(text: str) -> bool:
    if text.lower() not in _TRUE_WORDS | _FALSE_WORDS:
        raise ValueError
    return text.lower() in _TRUE_WORDS


def _parse_none(text: str) -> None:
    if text.lower() not in ("", "none", "null"):
        raise ValueError


def _describe_type(annotation: Any) -> str:
    """Return a phrase for the values that a type allows, such as ``a whole number``."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _describe_type(get_args(annotation)[0])
    if origin is Literal:
        return f"one of {', '.join(str(value) for value in get_args(annotation))}"
    if origin in (Union, types.UnionType):
        return " or ".join(_describe_type(member) for member in get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return f"one of {', '.join(str(member.value) for member in annotation)}"
    items: dict[Any, str] = {
        bool: "true or false",
        float: "a number",
        int: "a whole number",
        type(None): "none",
    }
    if origin in _SEQUENCE_TYPES:
        return f"{name_of(annotation)}, separated by commas"
    return items.get(annotation, name_of(annotation))


def name_of(annotation: Any) -> str:
    """Return the name of a Python type as an annotation shows it."""
    is_class = isinstance(annotation, type) and get_origin(annotation) is None
    return annotation.__name__ if is_class else str(annotation).replace("typing.", "")

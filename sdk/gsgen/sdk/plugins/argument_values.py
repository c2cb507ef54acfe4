"""Words of a command line as values of a type; nothing is evaluated."""

__all__ = ["convert", "name_of"]

import enum
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from gsgen.contract.errors import ConfigInvalid

_TRUE = frozenset({"1", "on", "true", "yes"})
_FALSE = frozenset({"0", "false", "no", "off"})
_SEQUENCES = (list, tuple, Sequence)


def convert(text: str, annotation: Any, where: str) -> Any:
    """Return ``text`` as a value of ``annotation``.

    Args:
        text: What the user typed.
        annotation: ``str``, ``int``, ``float``, ``bool``, ``Path``, an Enum, a Literal, a union or
            a list or tuple of those (separated by commas), or anything that takes no value.
        where: What to blame in an error, such as ``--arg side``.

    Raises:
        ConfigInvalid: It is not one.
    """
    try:
        return _converted(text, annotation)
    except ValueError as error:
        wanted = f"{text!r} is not {_described(annotation)}"
        raise ConfigInvalid(wanted, where=where) from error
    except TypeError as error:
        what = f"{name_of(annotation)} cannot be written on a command line"
        hint = "Give the parameter a default, or write a factory that takes words."
        raise ConfigInvalid(what, where=where, hint=hint) from error


def _converted(text: str, annotation: Any) -> Any:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _converted(text, get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return _first_that_fits(text, get_args(annotation))
    if origin is Literal:
        return _chosen(text, {str(value): value for value in get_args(annotation)})
    if origin in _SEQUENCES or annotation in _SEQUENCES:
        return _sequence(text, origin or annotation, get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        by_value = {str(one.value): one for one in annotation}
        return _chosen(text, by_value | {one.name: one for one in annotation})
    simple: dict[Any, Callable[[str], Any]] = {
        Any: str,
        Path: Path,
        bool: _truth,
        float: float,
        int: int,
        object: str,
        str: str,
        type(None): _nothing,
    }
    if annotation not in simple:
        raise TypeError
    return simple[annotation](text)


def _first_that_fits(text: str, members: Sequence[Any]) -> Any:
    """Try each member of a union, text last: everything is text."""
    for member in sorted(members, key=lambda one: one in (str, Path, Any)):
        try:
            return _converted(text, member)
        except (TypeError, ValueError):
            continue
    raise ValueError


def _sequence(text: str, kind: Any, members: Sequence[Any]) -> Any:
    words = [word.strip() for word in text.split(",")] if text else []
    fixed = kind is tuple and members and members[-1] is not Ellipsis
    if fixed and len(words) != len(members):
        raise ValueError
    types_of = members if fixed else [members[0] if members else str] * len(words)
    made = [_converted(word, one) for word, one in zip(words, types_of, strict=True)]
    return tuple(made) if kind is tuple else made


def _chosen(text: str, known: dict[str, Any]) -> Any:
    if text not in known:
        raise ValueError
    return known[text]


def _truth(text: str) -> bool:
    if text.lower() not in _TRUE | _FALSE:
        raise ValueError
    return text.lower() in _TRUE


def _nothing(text: str) -> None:
    if text.lower() not in ("", "none", "null"):
        raise ValueError


def _described(annotation: Any) -> str:
    """Return what a value of a type is, for people."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _described(get_args(annotation)[0])
    if origin is Literal:
        return f"one of {', '.join(str(value) for value in get_args(annotation))}"
    if origin in (Union, types.UnionType):
        return " or ".join(_described(one) for one in get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return f"one of {', '.join(str(one.value) for one in annotation)}"
    words: dict[Any, str] = {
        bool: "true or false",
        float: "a number",
        int: "a whole number",
        type(None): "none",
    }
    if origin in _SEQUENCES:
        return f"{name_of(annotation)}, separated by commas"
    return words.get(annotation, name_of(annotation))


def name_of(annotation: Any) -> str:
    """Return how people write a type."""
    plain = isinstance(annotation, type) and get_origin(annotation) is None
    return annotation.__name__ if plain else str(annotation).replace("typing.", "")

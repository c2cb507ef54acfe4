"""Parses splat edits of a command line, such as ``--scale 2``: names, values and functions."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, final

from gsgen.formats.editing.filters import (
    morton_ordered,
    where_value,
    within_box,
    within_sphere,
    without_floaters,
)
from gsgen.formats.editing.transforms import rotated, scaled, translated
from gsgen.formats.merging.decimation import decimate
from gsgen.formats.shared.errors import ValueInvalid, quoted
from gsgen.formats.shared.splats import Splats

Edit = Callable[[Splats], Splats]


@final
@dataclass(frozen=True, slots=True)
class Option:
    """A command-line option that edits splats: the form of its value, and its parser.

    Attributes:
        metavar: The form of its value; empty for a flag.
        parse: Returns the edit of a value.
        is_row_wise: Whether each splat is edited without regard to the others.
    """

    metavar: str
    parse: Callable[[str], Edit]
    is_row_wise: bool = True


@final
@dataclass(frozen=True, slots=True)
class ParsedEdit:
    """A function that edits splats, parsed from an option; it raises if no splat is left.

    Attributes:
        text: The option and its value.
        apply: Edits splats, of which none may be left.
        is_row_wise: Whether each splat is edited without regard to the others.
    """

    text: str
    apply: Edit
    is_row_wise: bool

    def __call__(self, splats: Splats) -> Splats:
        """Apply the edit and return the edited splats; raise if no splat is left."""
        result = self.apply(splats)
        if not len(result):
            raise no_splats_left(self.text, len(splats))
        return result


def no_splats_left(edits: str, count: int) -> ValueInvalid:
    """Return the error for splat edits that remove all of ``count`` splats."""
    return ValueInvalid(f"{edits} leaves none of {count} splats", expected="at least one splat")


def _numbers(text: str, metavar: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != metavar.count(",") + 1 or not all(abs(n) < float("inf") for n in numbers):
        raise ValueInvalid(quoted(text), expected=f"finite numbers {metavar}")
    return numbers


def _numeric_edit_option(edit: Callable[..., Splats], metavar: str) -> Option:
    def parse(text: str) -> Edit:
        numbers = _numbers(text, metavar)
        return lambda splats: edit(splats, numbers)

    return Option(metavar, parse)


def _parse_decimation(text: str) -> Edit:
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(%?)", text)
    amount = float(match[1]) if match else 0.0
    is_invalid = amount > 100 if match and match[2] else amount % 1 > 0
    if not amount or is_invalid:
        raise ValueInvalid(quoted(text), expected="a number of splats, or a percentage such as 25%")
    is_percentage = text.endswith("%")

    def merge(splats: Splats) -> Splats:
        count = int(len(splats) * amount / 100) if is_percentage else int(amount)
        return decimate(splats, max(1, count))

    return merge


def _parse_scaling(text: str) -> Edit:
    (factor,) = _numbers(text, "FACTOR")
    return lambda splats: scaled(splats, factor)


def _parse_floaters(text: str) -> Edit:
    size, neighbours = _numbers(text, "SIZE,COUNT")
    return lambda splats: without_floaters(splats, size, int(neighbours))


EDIT_OPTIONS: Final[dict[str, Option]] = {
    "translate": _numeric_edit_option(translated, "X,Y,Z"),
    "rotate": _numeric_edit_option(rotated, "X,Y,Z"),
    "scale": Option("FACTOR", _parse_scaling),
    "box": _numeric_edit_option(within_box, "X,Y,Z,X,Y,Z"),
    "sphere": _numeric_edit_option(within_sphere, "X,Y,Z,RADIUS"),
    "where": Option("CONDITION", lambda text: partial(where_value, condition=text)),
    "drop_floaters": Option("SIZE,COUNT", _parse_floaters, is_row_wise=False),
    "decimate": Option("N|N%", _parse_decimation, is_row_wise=False),
    "morton": Option("", lambda text: morton_ordered, is_row_wise=False),
}
"""The edits by name."""


def parse_edit(name: str, text: str) -> ParsedEdit:
    """Parse a splat edit, such as ``scale`` with the value ``2``, into a function of splats.

    Raises:
        ValueInvalid: The value has another form.
    """
    option = EDIT_OPTIONS[name]
    return ParsedEdit(f"--{name.replace('_', '-')} {text}", option.parse(text), option.is_row_wise)

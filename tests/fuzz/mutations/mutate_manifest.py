"""Mutations of a manifest: JSON that people and programs get wrong, and JSON made to hurt."""

__all__ = ["MUTATIONS", "Mutation"]

import json
import random
from collections.abc import Callable, Iterator
from typing import Any

from fuzz.mutations.mutate_model import NUMBERS, TEXTS
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS, ROLES

Mutation = Callable[[str, random.Random], str]
Place = tuple[Any, Any]  # a list or an object, and the index or key in it

_HOSTILE_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 0.5, 1e308, -1e308, 5e-324, float("nan"), float("inf")),
    *(10**400, -(10**30), [], {}, [[]], [None], {"a": {}}, "\ud800", "\0", "1.0", "2.0"),
    *("0.9", "1.99", "1", "01.0", "1.0.0", "99.0", "float16", "sh", "rgb", "row", "+q", "-y"),
    *([0, 1], [1, 0], [0, 0, 0], [-1e308, 1e308], [1e-320, 1e-320], [float("nan"), 1]),
)
_KEYS = ("name", "inputs", "role", "range", "contract", "kind", "x", "", "__class__", "min")


def _places(value: Any) -> Iterator[Place]:
    """Yield every place in a document that holds something."""
    queue = [value]
    while queue:
        node = queue.pop()
        for key in node if isinstance(node, dict) else range(len(node)):
            yield node, key
            if isinstance(node[key], dict | list):
                queue.append(node[key])


def _edited(text: str, edit: Callable[[Any, list[Place]], None]) -> str:
    """Return the document after ``edit``, or the text where it is none that Python can write."""
    try:
        document = json.loads(text)
        places = list(_places(document)) if isinstance(document, dict | list) else []
        if places:
            edit(document, places)
        return json.dumps(document, ensure_ascii=False)
    except (ValueError, RecursionError):
        return text


def replace_a_value(text: str, rng: random.Random) -> str:
    """Put anything in the place of a value."""

    def edit(_: Any, places: list[Place]) -> None:
        container, key = rng.choice(places)
        pool = rng.choice((_HOSTILE_VALUES, NUMBERS, TEXTS, tuple(ROLES), MANIFEST_KINDS))
        container[key] = rng.choice(pool)

    return _edited(text, edit)


def drop_a_key(text: str, rng: random.Random) -> str:
    """Leave something out."""

    def edit(_: Any, places: list[Place]) -> None:
        container, key = rng.choice(places)
        del container[key]

    return _edited(text, edit)


def add_a_key(text: str, rng: random.Random) -> str:
    """Say something that the schema does not know, or not there."""

    def edit(document: Any, places: list[Place]) -> None:
        objects = [document, *(h[k] for h, k in places if isinstance(h[k], dict))]
        container = rng.choice([entry for entry in objects if isinstance(entry, dict)] or [{}])
        container[rng.choice((*_KEYS, *TEXTS))] = rng.choice((*_HOSTILE_VALUES, *TEXTS))

    return _edited(text, edit)


def move_a_value(text: str, rng: random.Random) -> str:
    """Put a copy of one value in the place of another: two of a role, a box for a range."""

    def edit(_: Any, places: list[Place]) -> None:
        (container, key), (source, name) = rng.choice(places), rng.choice(places)
        container[key] = json.loads(json.dumps(source[name]))

    return _edited(text, edit)


def repeat_an_entry(text: str, rng: random.Random) -> str:
    """Repeat an entry of a list, once or a thousand times."""

    def edit(_: Any, places: list[Place]) -> None:
        lists = [h for h, _ in places if isinstance(h, list)]
        if lists:
            array = rng.choice(lists)
            array.extend([rng.choice(array)] * rng.choice((1, 1, 1000)))

    return _edited(text, edit)


def nest_value(text: str, rng: random.Random) -> str:
    """Nest a value deeper than a reader's stack goes."""
    depth = rng.choice((10, 300, 900, 3000, 200_000))
    opening, closing_bracket = rng.choice((("[", "]"), ('{"a":', "}")))
    deep = opening * depth + "1" + closing_bracket * depth
    offset = text.find(":")
    if offset < 0 or rng.random() < 0.3:
        return deep
    end = text.find(",", offset)
    return f"{text[: offset + 1]}{deep}{text[end:]}"


def damage(text: str, rng: random.Random) -> str:
    """Make a text that is no JSON, or JSON in an odd spelling."""
    offset = rng.randint(0, len(text))
    inserted = (
        *("NaN", "-Infinity", "1e999", "9" * 5000, "\ufeff", "//", "'", ",", "\0", "}", "["),
        *('"', "\\ud800", '{"a":1,"a":2}', "-0", "0x10", "\u2028"),
    )
    how = rng.randrange(4)
    if how == 0:
        return text[:offset]
    if how == 1:
        return text[:offset] + rng.choice(inserted) + text[offset:]
    if how == 2:
        return rng.choice((*inserted, "", "null", "true", "3", '"text"', "[]", "{}"))
    return text[:offset] + text[offset + rng.randint(1, 20) :]


MUTATIONS: tuple[Mutation, ...] = (
    *(replace_a_value,) * 4,
    *(drop_a_key, add_a_key, move_a_value, repeat_an_entry, nest_value, damage),
)

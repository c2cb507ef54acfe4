"""The fields of a JSON report, from the dataclasses behind its schema."""

from collections.abc import Iterator
from typing import Any

from docs_parts.manifest import type_in_words
from docs_parts.tables import table
from gsgen.contract.reporters.document import schema

_REFERENCE = "#/$defs/"


def fields(name: str) -> str:
    """Return the fields of the object ``name`` and of all inside it, as dotted paths."""
    definitions: Any = schema()["$defs"]
    return table(("field", "type", "", "meaning"), _rows(definitions, name, ""))


def _rows(definitions: Any, name: str, path: str) -> Iterator[tuple[str, ...]]:
    entry = definitions[name]
    for key, inner in entry["properties"].items():
        is_list = inner.get("type") == "array"
        field_path = f"{path}{key}{'[]' if is_list else ''}"
        inside = inner["items"] if is_list else inner
        need = "" if key in entry["required"] else "may be absent"
        reference = inside.get("$ref", "").removeprefix(_REFERENCE)
        if not reference:
            kind = {key: value for key, value in inside.items() if key != "pattern"}
            yield (f"`{field_path}`", type_in_words(kind), need, inner.get("description", "–"))
            continue
        text = inner.get("description") or definitions[reference]["description"]
        yield f"`{field_path}`", "object", need, text
        yield from _rows(definitions, reference, f"{field_path}.")

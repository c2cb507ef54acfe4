"""Checks JSON documents against the keywords that the JSON Schemas of manifests have.

Importing jsonschema takes a sixth of a static validation, and web pages, for which this module is
translated, have no such library.
"""

__all__ = ["Schema", "SchemaFault", "schema_faults"]

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

Schema = dict[str, Any]

# Keywords that say nothing about validity, and one that `properties` needs.
_ANNOTATION_KEYWORDS = ("$schema", "$defs", "title", "description", "default", "examples")


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemaFault:
    """A keyword of a JSON Schema that a part of a document breaks, as jsonschema's errors are.

    Attributes:
        validator: The keyword.
        validator_value: Its value.
        instance: The part of the document.
        schema: The schema of that part.
        absolute_path: The keys that lead to the part.
        message: The missing name in quotes where the keyword is ``required``; else empty.
    """

    validator: str
    validator_value: Any
    instance: Any
    schema: Any
    absolute_path: tuple[str | int, ...]
    message: str = ""


def schema_faults(document: object, schema: Schema) -> Iterator[SchemaFault]:
    """Yield each keyword of a JSON Schema that a part of a document breaks, or that is unknown."""
    yield from _schema_faults(document, schema, (), schema.get("$defs", {}))


def _schema_faults(
    value: Any, schema: Any, path: tuple[str | int, ...], definitions: dict[str, Schema]
) -> Iterator[SchemaFault]:
    if isinstance(schema, bool):
        return
    for word, entry in schema.items():
        if word in _ANNOTATION_KEYWORDS:
            continue
        if word == "$ref":
            yield from _schema_faults(value, definitions[entry.split("/")[-1]], path, definitions)
        elif word == "items":
            for number, item in enumerate(value if isinstance(value, list) else ()):
                yield from _schema_faults(item, entry, (*path, number), definitions)
        elif word == "required":
            for name in entry if isinstance(value, dict) else ():
                if name not in value:
                    yield _schema_fault(word, value, schema, path, message=repr(name))
        elif word in ("properties", "patternProperties", "additionalProperties"):
            if isinstance(value, dict):
                yield from _member_faults(word, value, schema, path, definitions)
        elif word == "anyOf":
            options = [list(_schema_faults(value, option, path, definitions)) for option in entry]
            if all(options):
                yield _schema_fault(word, value, schema, path)
        elif not _is_constraint_met(word, entry, value):
            yield _schema_fault(word, value, schema, path)


def _schema_fault(
    word: str, value: object, schema: Schema, path: tuple[str | int, ...], *, message: str = ""
) -> SchemaFault:
    return SchemaFault(
        validator=word,
        validator_value=schema[word],
        instance=value,
        schema=schema,
        absolute_path=path,
        message=message,
    )


def _member_faults(
    word: str,
    value: dict[str, Any],
    schema: Schema,
    path: tuple[str | int, ...],
    definitions: dict[str, Schema],
) -> Iterator[SchemaFault]:
    """Yield the faults that one of the three keywords of an object's members has."""
    properties, patterns = schema.get("properties", {}), schema.get("patternProperties", {})
    for name, part in value.items():
        matching_rules = [rule for pattern, rule in patterns.items() if re.search(pattern, name)]
        rules = matching_rules if word == "patternProperties" else []
        if word == "properties" and name in properties:
            rules = [properties[name]]
        elif word == "additionalProperties" and name not in properties and not matching_rules:
            if schema[word] is False:
                yield _schema_fault(word, value, schema, path)
                return  # one fault for all names
            rules = [schema[word]]
        for rule in rules:
            yield from _schema_faults(part, rule, (*path, name), definitions)


def _is_constraint_met(word: str, bound: Any, value: Any) -> bool:
    """Return whether a keyword without further schemas holds; False for unknown keywords."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if word == "type":
        return _is_type(bound, value)
    if word == "enum":  # true is not 1
        is_bool = isinstance(value, bool)
        return any(isinstance(option, bool) == is_bool and option == value for option in bound)
    if word in ("minimum", "maximum", "exclusiveMinimum"):
        if not is_number:
            return True
        if word == "maximum":
            return bool(value <= bound)
        return bool(value >= bound if word == "minimum" else value > bound)
    if word in ("minItems", "maxItems"):
        if not isinstance(value, list):
            return True
        return bool(len(value) >= bound if word == "minItems" else len(value) <= bound)
    if word in ("minLength", "pattern"):
        if not isinstance(value, str):
            return True
        return bool(len(value) >= bound if word == "minLength" else re.search(bound, value))
    return False


def _is_type(name: str, value: Any) -> bool:
    """Return whether a JSON value has a type of JSON Schema; False for unknown types."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if name == "integer":
        return is_number and bool(value == int(value))
    if name == "number":
        return is_number
    if name == "object":
        return isinstance(value, dict)
    if name == "array":
        return isinstance(value, list)
    if name == "string":
        return isinstance(value, str)
    return isinstance(value, bool) if name == "boolean" else name == "null" and value is None

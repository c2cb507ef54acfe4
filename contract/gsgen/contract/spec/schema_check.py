"""Checks JSON documents against a JSON Schema quickly, without explaining faults.

Importing jsonschema takes a sixth of a static validation. Documents that :func:`accepts` are valid;
for all others, jsonschema decides and finds the faults.
"""

__all__ = ["accepts"]

import re
from collections.abc import Callable, Mapping
from typing import Any

Schema = Mapping[str, Any]

# Keywords that say nothing about validity.
_NOTES = frozenset({"$schema", "$defs", "title", "description", "default", "examples"})


def accepts(schema: Schema, document: object) -> bool:
    """Return True only if a JSON document surely follows a schema; unknown keywords give False."""
    return _Check(schema.get("$defs", {})).accepts(schema, document)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


_TYPES: dict[str, Callable[[Any], bool]] = {
    "object": lambda value: isinstance(value, dict),
    "array": lambda value: isinstance(value, list),
    "string": lambda value: isinstance(value, str),
    "boolean": lambda value: isinstance(value, bool),
    "number": _is_number,
    "integer": lambda value: _is_number(value) and value == int(value),
    "null": lambda value: value is None,
}
# Keyword → whether (its value, the document) agree; a keyword concerns documents of its type only.
_LIMITS: dict[str, Callable[[Any, Any], bool]] = {
    "minimum": lambda bound, value: not _is_number(value) or value >= bound,
    "maximum": lambda bound, value: not _is_number(value) or value <= bound,
    "exclusiveMinimum": lambda bound, value: not _is_number(value) or value > bound,
    "minLength": lambda bound, value: not isinstance(value, str) or len(value) >= bound,
    "pattern": lambda regex, value: not isinstance(value, str) or bool(re.search(regex, value)),
    "minItems": lambda bound, value: not isinstance(value, list) or len(value) >= bound,
    "maxItems": lambda bound, value: not isinstance(value, list) or len(value) <= bound,
    "required": lambda names, value: not isinstance(value, dict) or value.keys() >= set(names),
}


class _Check:
    """Evaluates the keywords of one JSON Schema."""

    def __init__(self, definitions: Mapping[str, Schema]) -> None:
        self.definitions = definitions

    def accepts(self, schema: Any, value: object) -> bool:
        if isinstance(schema, bool):
            return schema
        return all(self._holds(word, schema, value) for word in schema if word not in _NOTES)

    def _holds(self, keyword: str, schema: Schema, value: object) -> bool:
        entry = schema[keyword]
        if keyword == "type":
            return isinstance(entry, str) and entry in _TYPES and _TYPES[entry](value)
        if keyword == "enum":  # true is not 1
            return any(type(option) is type(value) and option == value for option in entry)
        if keyword in _LIMITS:
            return _LIMITS[keyword](entry, value)
        if keyword == "$ref":
            name = str(entry).removeprefix("#/$defs/")
            return name in self.definitions and self.accepts(self.definitions[name], value)
        if keyword == "anyOf":
            return any(self.accepts(option, value) for option in entry)
        if keyword == "items":
            return not isinstance(value, list) or all(self.accepts(entry, item) for item in value)
        if keyword in ("properties", "patternProperties", "additionalProperties"):
            return not isinstance(value, dict) or self._members(keyword, schema, value)
        return False

    def _members(self, keyword: str, schema: Schema, value: dict[str, object]) -> bool:
        properties = schema.get("properties", {})
        patterns = schema.get("patternProperties", {})
        if keyword == "properties":
            return all(self.accepts(properties[k], v) for k, v in value.items() if k in properties)
        matching = {
            name: [rule for pattern, rule in patterns.items() if re.search(pattern, name)]
            for name in value
        }
        if keyword == "patternProperties":
            return all(
                self.accepts(rule, value[k]) for k, rules in matching.items() for rule in rules
            )
        others = (k for k in value if k not in properties and not matching[k])
        return all(self.accepts(schema["additionalProperties"], value[name]) for name in others)

"""Converts dataclasses to JSON Schema 2020-12, and dataclass instances to and from JSON.

:func:`schema_of` writes the published schema of a dataclass, :func:`to_json` and
:func:`from_json` convert its instances.
"""

__all__ = ["SCHEMA_DIALECT", "Hint", "Json", "from_json", "schema_of", "to_json"]

import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"

# What `json.loads` gives.
Json = dict[str, "Json"] | list["Json"] | str | int | float | bool | None

_SCHEMA_BY_SCALAR_TYPE: dict[object, dict[str, object]] = {
    str: {"type": "string"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    type(None): {"type": "null"},
}
# Third parties may add fields of their own under this prefix.
_EXTENSION_PATTERN = "^x-"


@dataclass(frozen=True, slots=True, kw_only=True)
class Hint:
    """Metadata of a dataclass field, in ``Annotated[...]``, that become JSON Schema keywords."""

    text: str = ""
    minimum: float | None = None
    exclusive_minimum: float | None = None
    maximum: float | None = None
    min_length: int | None = None
    pattern: str | None = None
    enum: tuple[str, ...] = ()

    def keywords(self) -> dict[str, object]:
        """Return the metadata of a dataclass field as JSON Schema keywords."""
        bound_by_schema_keyword = {
            "description": self.text or None,
            "minimum": self.minimum,
            "exclusiveMinimum": self.exclusive_minimum,
            "maximum": self.maximum,
            "minLength": self.min_length,
            "pattern": self.pattern,
            "enum": list(self.enum) or None,
        }
        return {key: value for key, value in bound_by_schema_keyword.items() if value is not None}


def schema_of(cls: type, *, title: str | None = None) -> dict[str, object]:
    """Return the JSON Schema of a frozen dataclass, with nested dataclasses in ``$defs``."""
    definitions: dict[str, object] = {}
    body = _object_schema(cls, definitions)
    head: dict[str, object] = {"$schema": SCHEMA_DIALECT, "title": title or cls.__name__}
    return head | body | {"$defs": dict(sorted(definitions.items()))}


def _object_schema(cls: type, definitions: dict[str, object]) -> dict[str, object]:
    hints = get_type_hints(cls, include_extras=True)
    required = [
        _json_key(f) for f in fields(cls) if f.default is MISSING and f.default_factory is MISSING
    ]
    properties: dict[str, object] = {}
    for f in fields(cls):
        entry = _type_schema(hints[f.name], definitions)
        if f.default is not MISSING and f.default is not None and not is_dataclass(f.default):
            entry = entry | {"default": to_json(f.default)}
        properties[_json_key(f)] = entry
    return {
        "type": "object",
        "description": (cls.__doc__ or "").strip().splitlines()[0],
        "properties": properties,
        "patternProperties": {_EXTENSION_PATTERN: True},
        "additionalProperties": False,
        "required": required,
    }


def _type_schema(hint: Any, definitions: dict[str, object]) -> dict[str, object]:
    origin = get_origin(hint)
    if origin is Annotated:
        base, *extra_hints = get_args(hint)
        entry = _type_schema(base, definitions)
        for annotation in extra_hints:
            if isinstance(annotation, Hint):
                entry = _add_constraints(entry, annotation)
        return entry
    if origin is Literal:
        return {"enum": list(get_args(hint))}
    if origin in (typing.Union, types.UnionType):
        options = [o for o in get_args(hint) if o is not type(None)]
        if len(options) == 1:
            return _type_schema(options[0], definitions)  # absent rather than null
        return {"anyOf": [_type_schema(option, definitions) for option in options]}
    if origin is tuple:
        return _tuple_schema(get_args(hint), definitions)
    if origin is dict:
        _, value = get_args(hint)
        return {"type": "object", "additionalProperties": _type_schema(value, definitions)}
    if is_dataclass(hint) and isinstance(hint, type):
        if hint.__name__ not in definitions:
            definitions[hint.__name__] = {}  # its place, should it refer to itself
            definitions[hint.__name__] = _object_schema(hint, definitions)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    return dict(_SCHEMA_BY_SCALAR_TYPE[hint])


def _add_constraints(entry: dict[str, object], hint: Hint) -> dict[str, object]:
    """Add the constraints of a dataclass field to its JSON Schema."""
    return entry | hint.keywords()


def _tuple_schema(args: tuple[Any, ...], definitions: dict[str, object]) -> dict[str, object]:
    if len(args) == 2 and args[1] is Ellipsis:
        return {"type": "array", "items": _type_schema(args[0], definitions)}
    size = len(args)
    item = _type_schema(args[0], definitions)  # all our fixed tuples hold one type
    return {"type": "array", "items": item, "minItems": size, "maxItems": size}


def to_json(value: Any) -> Any:
    """Convert a dataclass instance to JSON types, without absent fields."""
    if is_dataclass(value) and not isinstance(value, type):
        members = ((f, getattr(value, f.name)) for f in fields(value))
        return {
            _json_key(f): to_json(entry) for f, entry in members if not _is_absent_value(f, entry)
        }
    if isinstance(value, (tuple, list)):
        return [to_json(item) for item in value]
    if isinstance(value, Mapping):
        return {key: to_json(item) for key, item in value.items()}
    return value


def _json_key(field: "Field[Any]") -> str:
    """Return a dataclass field's name in JSON: `from_` becomes `from`, a Python keyword."""
    return field.name.removesuffix("_")


def _is_absent_value(field: "Field[Any]", value: Any) -> bool:
    """Return whether JSON omits a dataclass field: a value of None, or an empty default."""
    if value is None:
        return True
    default = field.default
    if field.default_factory is not MISSING:
        default = field.default_factory()
    return value in ((), {}) and value == default


def from_json(hint: Any, value: Any) -> Any:
    """Build a dataclass instance from JSON that fits its schema; unknown keys are ignored."""
    origin = get_origin(hint)
    if origin is Annotated:
        return from_json(get_args(hint)[0], value)
    if origin in (typing.Union, types.UnionType):
        return _value_from_union(get_args(hint), value)
    if origin is tuple:
        item = get_args(hint)[0]
        return tuple(from_json(item, element) for element in value)
    if origin is dict:
        return {key: from_json(get_args(hint)[1], element) for key, element in value.items()}
    if is_dataclass(hint) and isinstance(hint, type):
        members = _class_members(hint)
        known = [(*members[key], entry) for key, entry in value.items() if key in members]
        return hint(**{name: from_json(kind, entry) for name, kind, entry in known})
    if hint is float:
        return float(value)
    if hint is int:
        return int(value)  # JSON Schema calls 3.0 an integer
    return value


@cache
def _class_members(cls: type) -> dict[str, tuple[str, Any]]:
    """Map the JSON key of each dataclass field to the field's name and type."""
    hints = get_type_hints(cls, include_extras=True)
    return {_json_key(field): (field.name, hints[field.name]) for field in fields(cls)}


def _value_from_union(options: tuple[Any, ...], value: Any) -> Any:
    if value is None:
        return None
    for option in options:
        bare_type = get_args(option)[0] if get_origin(option) is Annotated else option
        origin = get_origin(bare_type)
        if isinstance(value, (list, tuple)) == (origin is tuple):
            if isinstance(value, str) != (bare_type is str or origin is Literal):
                continue
            if option is not type(None):
                return from_json(option, value)
    return value

"""Checks metadata of tilesets: schemas, and the entities and statistics that refer to them.

3D Metadata Specification 1.0, and the 3D Metadata Semantic Reference. A value is a number, text or
a boolean; vectors and matrices are arrays of numbers; an array property holds an array of values.
"""

__all__ = ["check_entity", "check_metadata_schema", "check_statistics"]

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.format.implicit_tiling.property_table import NUMBER_COUNT_BY_TYPE
from gsgen.tiles.format.json_values import JsonDict, JsonObject, is_number, shorten
from gsgen.tiles.format.schema import COMPONENT_RANGES

_FLOATS: Final = ("FLOAT32", "FLOAT64")
_DEFAULT_ENUM_TYPE: Final = "UINT16"
_TOLERANCE: Final = 1e-6  # relative: bounds are written in decimals, values are stored in float32


@final
@dataclass(frozen=True, slots=True)
class _Layout:
    """The type that a semantic prescribes for its property; an empty value prescribes nothing."""

    type: str
    components: tuple[str, ...] = ()
    array: bool = False
    count: int | None = None


def _volume_layouts(prefix: str) -> dict[str, _Layout]:
    return {
        f"{prefix}_BOUNDING_BOX": _Layout("SCALAR", _FLOATS, array=True, count=12),
        f"{prefix}_BOUNDING_REGION": _Layout("SCALAR", ("FLOAT64",), array=True, count=6),
        f"{prefix}_BOUNDING_SPHERE": _Layout("SCALAR", _FLOATS, array=True, count=4),
        f"{prefix}_BOUNDING_S2_CELL": _Layout("SCALAR", ("UINT64",)),
        f"{prefix}_MINIMUM_HEIGHT": _Layout("SCALAR", _FLOATS),
        f"{prefix}_MAXIMUM_HEIGHT": _Layout("SCALAR", _FLOATS),
        f"{prefix}_HORIZON_OCCLUSION_POINT": _Layout("VEC3", _FLOATS),
    }


_LAYOUT_BY_SEMANTIC: Final = {
    "ID": _Layout("STRING"),
    "NAME": _Layout("STRING"),
    "DESCRIPTION": _Layout("STRING"),
    "ATTRIBUTION_IDS": _Layout("ENUM", array=True),
    "ATTRIBUTION_STRINGS": _Layout("STRING", array=True),
    "TILESET_FEATURE_ID_LABELS": _Layout("STRING", array=True),
    "TILESET_CRS_GEOCENTRIC": _Layout("STRING"),
    "TILESET_CRS_COORDINATE_EPOCH": _Layout("STRING"),
    "TILE_GEOMETRIC_ERROR": _Layout("SCALAR", _FLOATS),
    "TILE_REFINE": _Layout("SCALAR", ("UINT8",)),
    "TILE_TRANSFORM": _Layout("MAT4", _FLOATS),
    "CONTENT_URI": _Layout("STRING"),
    "CONTENT_GROUP_ID": _Layout("SCALAR", ("UINT8", "UINT16", "UINT32", "UINT64")),
    **_volume_layouts("TILE"),
    **_volume_layouts("CONTENT"),
}


def check_metadata_schema(schema: JsonObject) -> Iterator[TilesetInvalid]:
    """Yield what contradicts itself in a metadata schema whose members have the right types."""
    enums = schema.values.get("enums", {})
    for name in enums:
        yield from _enum_faults(schema.child("enums").child(name))
    for name, entry in schema.values.get("classes", {}).items():
        if "properties" not in entry:
            continue
        properties = schema.child("classes").child(name).child("properties")
        semantics: set[str] = set()
        for key in properties.values:
            column = properties.child(key)
            yield from _property_faults(column, enums)
            semantic = column.values.get("semantic")
            if semantic is None:
                continue
            if semantic in semantics:
                yield _fault(column, "semantic", "a semantic that no other property has")
            semantics.add(semantic)


def _fault(entry: JsonObject, key: str, expected: str) -> TilesetInvalid:
    actual = shorten(entry.values[key]) if key in entry else "the member is missing"
    return TilesetInvalid(actual, location=entry.at(key), expected=expected)


def _enum_faults(entry: JsonObject) -> Iterator[TilesetInvalid]:
    """Yield names and values of an enum that are repeated or out of range."""
    value_type = entry.values.get("valueType", _DEFAULT_ENUM_TYPE)
    least, most = COMPONENT_RANGES[value_type]
    for key in ("name", "value"):
        known: set[object] = set()
        for item in entry.objects("values"):
            value = item.values[key]
            if value in known:
                yield _fault(item, key, f"a {key} that no other entry has")
            known.add(value)
            if key == "value" and not least <= value <= most:
                yield _fault(item, key, f"a {value_type}: {least} to {most}")


def _property_faults(column: JsonObject, enums: JsonDict) -> Iterator[TilesetInvalid]:
    """Yield the members of a class property that its type excludes, requires or contradicts."""
    values = column.values
    kind, component = values["type"], values.get("componentType")
    is_numeric, is_array = kind in NUMBER_COUNT_BY_TYPE, values.get("array", False)
    is_normalized = values.get("normalized", False)
    is_whole_component = component in COMPONENT_RANGES
    # Which members a type requires or excludes: member → (excluded, expected).
    if is_numeric and component is None:
        yield _fault(column, "componentType", f"a component type, which {kind} requires")
    if kind == "ENUM" and values.get("enumType") not in enums:
        yield _fault(
            column, "enumType", f"an enum of the schema: {', '.join(enums) or 'none there'}"
        )
    is_fixed = not is_array or "count" in values
    is_scalable = is_numeric and is_fixed and (component in _FLOATS or is_normalized)
    excluded = {
        "componentType": (not is_numeric, f"no component type of {kind}"),
        "enumType": (kind != "ENUM", f"no enum of {kind}"),
        "count": (not is_array, "no count without `array`: true"),
        "normalized": (
            bool(is_normalized) and not (is_numeric and is_whole_component),
            "false for all but whole numbers",
        ),
        "offset": (
            not is_scalable,
            "no offset but of float or normalized numbers, and no varying length",
        ),
        "scale": (
            not is_scalable,
            "no scale but of float or normalized numbers, and no varying length",
        ),
        "min": (not (is_numeric and is_fixed), "no bound but of numbers, and of no varying length"),
        "max": (not (is_numeric and is_fixed), "no bound but of numbers, and of no varying length"),
        "noData": (
            bool(values.get("required")) or kind == "BOOLEAN",
            "no such value where the property is required or boolean",
        ),
        "default": (bool(values.get("required")), "no default of a property that is required"),
    }
    for key, (is_excluded, expected) in excluded.items():
        if key not in values:
            continue
        if is_excluded:
            yield _fault(column, key, expected)
        elif key in ("offset", "scale", "min", "max"):
            yield from _value_faults(column, key, {**values, "componentType": "FLOAT64"}, enums)
        elif key in ("noData", "default"):
            yield from _value_faults(column, key, values, enums)
    yield from _semantic_faults(column)


def _semantic_faults(column: JsonObject) -> Iterator[TilesetInvalid]:
    """Yield a property whose type is not that which its semantic prescribes."""
    values = column.values
    layout = _LAYOUT_BY_SEMANTIC.get(values.get("semantic", ""))
    if layout is None:
        return
    fits = (
        values["type"] == layout.type
        and (not layout.components or values.get("componentType") in layout.components)
        and values.get("array", False) == layout.array
        and layout.count in (None, values.get("count"))
        and not values.get("normalized", False)
    )
    if not fits:
        length = "" if layout.count is None else f" of {layout.count}"
        text = f"{'an array' + length + ' of ' if layout.array else ''}{layout.type}"
        components = f" in {' or '.join(layout.components)}" if layout.components else ""
        yield _fault(column, "semantic", f"this semantic for {text}{components} alone")


def _value_faults(
    owner: JsonObject, key: str, column: JsonDict, enums: JsonDict
) -> Iterator[TilesetInvalid]:
    """Yield how a value differs from the type of its property."""
    value = owner.values[key]
    entries = [value]
    if column.get("array"):
        if not isinstance(value, list) or column.get("count", len(value)) != len(value):
            yield _fault(owner, key, f"an array of {column.get('count', 'any number of')} values")
            return
        entries = value
    kind = column["type"]
    if kind == "ENUM":
        names = [
            entry["name"] for entry in enums.get(column.get("enumType", ""), {}).get("values", ())
        ]
        if not all(entry in names for entry in entries):
            yield _fault(owner, key, f"names of the enum: {', '.join(names)}")
    elif kind in ("STRING", "BOOLEAN"):
        needed = str if kind == "STRING" else bool
        if not all(isinstance(entry, needed) for entry in entries):
            yield _fault(owner, key, f"a value of type {kind}")
    else:
        yield from _number_faults(owner, key, column, entries)


def _number_faults(
    owner: JsonObject, key: str, column: JsonDict, entries: list[Any]
) -> Iterator[TilesetInvalid]:
    kind, component = column["type"], column.get("componentType")
    width = NUMBER_COUNT_BY_TYPE[kind]
    rows = [[entry] if width == 1 else entry for entry in entries]
    if not all(isinstance(row, list) and len(row) == width for row in rows):
        yield _fault(owner, key, f"{width} numbers, as {kind} has")
        return
    numbers = [number for row in rows for number in row]
    if not all(map(is_number, numbers)):
        yield _fault(owner, key, f"finite numbers of type {component}")
    elif component in COMPONENT_RANGES:
        least, most = COMPONENT_RANGES[component]
        if not all(least <= n <= most and n == int(n) for n in numbers):
            yield _fault(owner, key, f"numbers of type {component}: {least} to {most}")


def check_entity(entity: JsonObject, schema: JsonObject | None) -> Iterator[TilesetInvalid]:
    """Yield how a metadata entity (of a tileset, group, tile or content) differs from its class."""
    name = entity.values.get("class")
    if not isinstance(name, str):
        return  # its own schema says so
    classes = schema.values.get("classes", {}) if schema else {}
    if name not in classes:
        names = ", ".join(classes) or "none there"
        yield _fault(entity, "class", f"a class of the metadata schema: {names}")
        return
    assert schema is not None
    columns = classes[name].get("properties", {})
    enums = schema.values.get("enums", {})
    values = entity.values.get("properties", {})
    if not isinstance(values, dict):
        return
    properties = JsonObject(values, entity.at("properties"))
    for key in values:
        if key not in columns:
            yield _fault(properties, key, f"a property of class {name}: {', '.join(columns)}")
    for key, column in columns.items():
        if values.get(key) is None:
            if column.get("required"):
                yield _fault(properties, key, "a value, which the class requires")
            continue
        if values[key] == column.get("noData"):
            continue
        faults = list(_value_faults(properties, key, column, enums))
        yield from faults or _range_faults(properties, key, column)


def _range_faults(owner: JsonObject, key: str, column: JsonDict) -> Iterator[TilesetInvalid]:
    """Yield a value that is less than ``min`` or more than ``max`` of its property.

    Both bounds are compared with the value that a reader computes: normalized to 0…1 or −1…1,
    times scale, plus offset.
    """
    if not ("min" in column or "max" in column):
        return
    value = np.asarray(owner.values[key], np.float64)
    if column.get("normalized"):
        value = np.maximum(value / COMPONENT_RANGES[column["componentType"]][1], -1)
    value = value * np.asarray(column.get("scale", 1)) + np.asarray(column.get("offset", 0))
    for name, sign in (("min", -1), ("max", 1)):
        if name in column:
            bound = np.asarray(column[name], np.float64)
            if (sign * (value - bound) > _TOLERANCE * np.maximum(np.abs(bound), 1)).any():
                words = "or more" if name == "min" else "or less"
                yield _fault(owner, key, f"{shorten(column[name])} {words}, {name} of its class")


def check_statistics(document: JsonObject, schema: JsonObject | None) -> Iterator[TilesetInvalid]:
    """Yield classes and properties in a tileset's statistics that its schema does not have."""
    statistics = document.values.get("statistics")
    entries = statistics.get("classes") if isinstance(statistics, dict) else None
    if not isinstance(entries, dict):
        return
    location = f"{document.at('statistics')}.classes"
    classes = schema.values.get("classes", {}) if schema else {}
    for name, entry in entries.items():
        if name not in classes:
            yield TilesetInvalid(
                shorten(name),
                location=location,
                expected=f"a class of the metadata schema: {', '.join(classes) or 'none there'}",
            )
            continue
        columns = classes[name].get("properties", {})
        properties = entry.get("properties") if isinstance(entry, dict) else None
        for key in properties if isinstance(properties, dict) else ():
            if key not in columns:
                yield TilesetInvalid(
                    shorten(key),
                    location=f"{location}.{name}.properties",
                    expected=f"a property of class {name}: {', '.join(columns)}",
                )

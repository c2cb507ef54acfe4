"""Reads columns of numbers from the property tables of implicit tilesets' subtrees.

3D Metadata Specification 1.0, section "Binary Table Format". Strings, and arrays whose length
varies from row to row, are passed over: nothing here asks for them.
"""

__all__ = ["NUMBER_COUNT_BY_TYPE", "PropertyClass", "read_classes", "read_property_table"]

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.json_values import JsonObject

NUMBER_COUNT_BY_TYPE: Final = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT2": 4,
    "MAT3": 9,
    "MAT4": 16,
}
"""Type of a metadata property → how many numbers a value has."""
_DTYPE_BY_COMPONENT: Final = {
    "INT8": "i1", "UINT8": "u1", "INT16": "<i2", "UINT16": "<u2", "INT32": "<i4",
    "UINT32": "<u4", "INT64": "<i8", "UINT64": "<u8", "FLOAT32": "<f4", "FLOAT64": "<f8",
}  # fmt: skip
_MAX_ARRAY_LENGTH = 4096


@final
@dataclass(frozen=True, slots=True)
class PropertyClass:
    """The numeric columns of a 3D Tiles metadata class: data type, and numbers per row.

    Attributes:
        columns: Property → (name it is known by, data type, numbers a row). The name is the
            semantic where the property has one.
    """

    columns: dict[str, tuple[str, np.dtype, int]]


def read_classes(schema: JsonObject | None) -> dict[str, PropertyClass]:
    """Return the classes of a 3D Tiles metadata schema by name; empty without a schema."""
    if schema is None or "classes" not in schema:
        return {}
    classes = schema.child("classes")
    return {name: _read_class(classes.child(name)) for name in classes.values}


def _read_class(entry: JsonObject) -> PropertyClass:
    columns: dict[str, tuple[str, np.dtype, int]] = {}
    properties = entry.optional("properties")
    for name in properties.values if properties else ():
        assert properties is not None
        column = properties.child(name)
        width = NUMBER_COUNT_BY_TYPE.get(str(column.values.get("type")))
        dtype = _DTYPE_BY_COMPONENT.get(str(column.values.get("componentType")))
        count = 1
        if column.values.get("array"):
            if "count" not in column:
                continue
            count = column.whole("count", least=1, most=_MAX_ARRAY_LENGTH)
        if width is None or dtype is None:
            continue
        semantic_name = column.text("semantic") if "semantic" in column else name
        columns[name] = semantic_name, np.dtype(dtype), width * count
    return PropertyClass(columns)


def read_property_table(
    table: JsonObject,
    count: int,
    classes: dict[str, PropertyClass],
    view: Callable[[JsonObject, str], bytes],
) -> dict[str, np.ndarray]:
    """Read the columns of a 3D Tiles property table, as arrays [rows] or [rows, numbers]."""
    name, rows = table.text("class"), table.whole("count")
    if name not in classes:
        table.refuse("class", f"a class of the schema: {', '.join(classes) or 'none there'}")
    if rows != count:
        table.refuse("count", f"{count}, as many as are available")
    columns: dict[str, np.ndarray] = {}
    properties = table.optional("properties")
    for key, (semantic_name, dtype, width) in classes[name].columns.items():
        if properties is None or key not in properties:
            continue
        entry = properties.child(key)
        data, size = view(entry, "values"), count * width * dtype.itemsize
        if len(data) < size:
            raise TilesetInvalid(
                f"the buffer view has {len(data)} bytes",
                location=entry.at("values"),
                expected=f"{size}: {count} rows of {width} × {dtype.name}",
                fault=Fault.SUBTREE,
            )
        values = np.frombuffer(data[:size], dtype).reshape(count, width)
        columns[semantic_name] = values[:, 0] if width == 1 else values
    return columns

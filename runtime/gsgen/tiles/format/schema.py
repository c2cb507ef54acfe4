"""The JSON Schemas of ``tileset.json``, its tiles and its metadata, as 3D Tiles 1.1 states them.

OGC 22-025r4, "Property reference" of 3D Tiles and of the 3D Metadata Specification. Names of drafts
and of version 1.0 that are still read (``url``, ``maximumLevel``) are accepted as well. The
description of a schema names the expected value.
"""

__all__ = [
    "COMPONENT_RANGES",
    "METADATA_SCHEMA",
    "SUBTREE_SCHEMA",
    "TILESET_SCHEMA",
    "TILE_SCHEMA",
    "Schema",
]

from typing import Any, Final

Schema = dict[str, Any]
"""A JSON Schema of draft 2020-12."""

COMPONENT_RANGES: Final = {
    f"{sign}INT{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if not sign else (0, 2**bits - 1)
    for sign in ("", "U")
    for bits in (8, 16, 32, 64)
}
"""Component type of whole numbers → the least and the largest value."""

_IDENTIFIER: Final = "^[a-zA-Z_][a-zA-Z0-9_]*$"
_TEXT: Final[Schema] = {"type": "string"}
_NAME: Final[Schema] = {"type": "string", "minLength": 1}
_FLAG: Final[Schema] = {"type": "boolean"}
_NUMBER: Final[Schema] = {"type": "number"}
_COUNT: Final[Schema] = {"type": "integer", "minimum": 0}
_LEVELS: Final[Schema] = {"type": "integer", "minimum": 1}
_NAMES: Final[Schema] = {"type": "array", "items": _TEXT, "minItems": 1}
_CLASS_NAME: Final[Schema] = {"type": "string", "pattern": _IDENTIFIER}
# A number, or arrays of numbers: vectors, matrices, and arrays of either.
_NUMERIC: Final[Schema] = {
    "anyOf": [_NUMBER, {"type": "array", "items": {"anyOf": [_NUMBER, {"type": "array"}]}}],
    "description": "a number, or an array of numbers",
}
_BASE_MEMBERS: Final[Schema] = {
    "extensions": {"type": "object", "additionalProperties": {"type": "object"}}
}


def _object(required: tuple[str, ...] = (), /, **properties: Schema) -> Schema:
    """Return the schema of an object, which may have extensions as well."""
    return {
        "type": "object",
        "required": list(required),
        "properties": {**_BASE_MEMBERS, **properties},
    }


def _dictionary(entry: Schema, *, least: int = 0) -> Schema:
    """Return the schema of an object whose keys are the caller's, with ``least`` keys or more."""
    return {"type": "object", "additionalProperties": entry, "minProperties": least}


def _identifiers(entry: Schema, *, least: int = 0) -> Schema:
    """Return the schema of an object whose keys are identifiers of metadata."""
    names: Schema = {"pattern": _IDENTIFIER, "description": "a name of letters, digits and _"}
    return {**_dictionary(entry, least=least), "propertyNames": names}


def _array(entry: Schema, *, least: int = 1) -> Schema:
    return {"type": "array", "items": entry, "minItems": least}


def _numbers(count: int) -> Schema:
    text = f"{count} finite numbers"
    return {
        "type": "array",
        "items": {**_NUMBER, "description": text},
        "minItems": count,
        "maxItems": count,
        "description": text,
    }


_ENTITY: Final = _object(("class",), **{"class": _CLASS_NAME}, properties={"type": "object"})
_VOLUME: Final[Schema] = {
    **_object(box=_numbers(12), region=_numbers(6), sphere=_numbers(4)),
    "anyOf": [{"required": [name]} for name in ("box", "region", "sphere", "extensions")],
    "description": "a box, a region or a sphere",
}
_CONTENT: Final[Schema] = {
    **_object(uri=_TEXT, url=_TEXT, metadata=_ENTITY, group=_COUNT, boundingVolume=_VOLUME),
    "anyOf": [{"required": ["uri"]}, {"required": ["url"]}],
    "description": "an object with a uri",
}
_IMPLICIT_TILING: Final[Schema] = {
    **_object(
        ("subdivisionScheme", "subtreeLevels", "subtrees"),
        subdivisionScheme={"enum": ["QUADTREE", "OCTREE"]},
        subtreeLevels=_LEVELS,
        availableLevels=_LEVELS,
        maximumLevel=_COUNT,
        subtrees=_object(("uri",), uri=_TEXT),
    ),
    "anyOf": [{"required": ["availableLevels"]}, {"required": ["maximumLevel"]}],
    "description": "an object with availableLevels",
}
_PROPERTY_STATISTICS: Final = _object(
    min=_NUMERIC,
    max=_NUMERIC,
    mean=_NUMERIC,
    median=_NUMERIC,
    standardDeviation=_NUMERIC,
    variance=_NUMERIC,
    sum=_NUMERIC,
    occurrences=_dictionary({"anyOf": [_COUNT, {"type": "array"}]}, least=1),
)
_CLASS_STATISTICS: Final = _object(
    count=_COUNT, properties=_dictionary(_PROPERTY_STATISTICS, least=1)
)
_CLASS_PROPERTY: Final = _object(
    ("type",),
    name=_TEXT,
    description=_TEXT,
    type={
        "enum": [
            *("SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"),
            *("STRING", "BOOLEAN", "ENUM"),
        ]
    },
    componentType={"enum": [*COMPONENT_RANGES, "FLOAT32", "FLOAT64"]},
    enumType=_TEXT,
    array=_FLAG,
    count={"type": "integer", "minimum": 2},
    normalized=_FLAG,
    offset=_NUMERIC,
    scale=_NUMERIC,
    max=_NUMERIC,
    min=_NUMERIC,
    required=_FLAG,
    semantic={"type": "string", "minLength": 1},
)
_ENUM: Final = _object(
    ("values",),
    name=_TEXT,
    description=_TEXT,
    valueType={"enum": list(COMPONENT_RANGES)},
    values=_array(
        _object(("name", "value"), name=_TEXT, description=_TEXT, value={"type": "integer"})
    ),
)

METADATA_SCHEMA: Final = _object(
    ("id",),
    id=_CLASS_NAME,
    name=_TEXT,
    description=_TEXT,
    version=_TEXT,
    classes=_identifiers(
        _object(name=_TEXT, description=_TEXT, properties=_identifiers(_CLASS_PROPERTY, least=1))
    ),
    enums=_identifiers(_ENUM),
)
"""Of a metadata schema, within ``tileset.json`` or in a file of its own."""

TILESET_SCHEMA: Final[Schema] = {
    **_object(
        ("asset", "geometricError", "root"),
        asset=_object(("version",), version=_TEXT, tilesetVersion=_TEXT),
        properties=_dictionary(_object(("minimum", "maximum"), minimum=_NUMBER, maximum=_NUMBER)),
        schema={"type": "object"},
        schemaUri=_TEXT,
        statistics=_object(classes=_dictionary(_CLASS_STATISTICS, least=1)),
        groups=_array(_ENTITY),
        metadata=_ENTITY,
        geometricError={"type": "number", "minimum": 0},
        root={"type": "object", "required": ["refine"]},
        extensionsUsed=_NAMES,
        extensionsRequired=_NAMES,
    ),
    "not": {"required": ["schema", "schemaUri"]},
    "description": "one of schema and schemaUri",
}
"""Of ``tileset.json``; the root tile is an object, and its schema is `TILE_SCHEMA`."""

TILE_SCHEMA: Final = _object(
    ("boundingVolume", "geometricError"),
    boundingVolume=_VOLUME,
    viewerRequestVolume=_VOLUME,
    geometricError={"type": "number", "minimum": 0},
    refine={"enum": ["ADD", "REPLACE"]},
    transform=_numbers(16),
    content=_CONTENT,
    contents=_array(_CONTENT),
    metadata=_ENTITY,
    implicitTiling=_IMPLICIT_TILING,
    children=_array({"type": "object"}),
)
"""Of one tile; its children are objects, which are tiles in turn."""

_AVAILABILITY: Final[Schema] = {
    **_object(
        bitstream=_COUNT, bufferView=_COUNT, availableCount=_COUNT, constant={"enum": [0, 1]}
    ),
    "oneOf": [{"required": [name]} for name in ("bitstream", "bufferView", "constant")],
    "description": "a bitstream or a constant",
}
_BYTES: Final[Schema] = {"type": "integer", "minimum": 1}
SUBTREE_SCHEMA: Final[Schema] = {
    **_object(
        ("tileAvailability", "childSubtreeAvailability"),
        buffers=_array(_object(("byteLength",), name=_NAME, uri=_TEXT, byteLength=_BYTES)),
        bufferViews=_array(
            _object(
                ("buffer", "byteOffset", "byteLength"),
                name=_NAME,
                buffer=_COUNT,
                byteOffset=_COUNT,
                byteLength=_BYTES,
            )
        ),
        propertyTables=_array(_object(("class", "count"), **{"class": _CLASS_NAME}, count=_BYTES)),
        tileAvailability=_AVAILABILITY,
        contentAvailability=_array(_AVAILABILITY),
        childSubtreeAvailability=_AVAILABILITY,
        tileMetadata=_COUNT,
        contentMetadata=_array(_COUNT),
        subtreeMetadata=_ENTITY,
    ),
    "dependentRequired": {"buffers": ["bufferViews"], "bufferViews": ["buffers"]},
    "description": "buffers and bufferViews, or neither",
}
"""Of the JSON of a subtree of an implicit tileset."""

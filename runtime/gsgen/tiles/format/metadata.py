"""The metadata schema of tilesets that gsgen writes."""

__all__ = [
    "FILES_PROPERTY",
    "TILESET_CLASS",
    "TILE_CLASS",
    "implicit_metadata_schema",
    "metadata_schema",
]

from typing import Final

from gsgen.tiles.format.json_values import JsonDict

FILES_PROPERTY: Final = "files"
"""Property of tiles, and for implicit ones of the tileset: a content's address at each quality."""
TILE_CLASS: Final = "gsgen_tile"
TILESET_CLASS: Final = "gsgen_tileset"

_SCALAR_PROPERTY: Final[JsonDict] = {"type": "SCALAR"}
_FILES: Final[JsonDict] = {
    "type": "STRING",
    "array": True,
    "description": "Address of the content at each quality, finest first.",
}


def _number(component: str, description: str, **members: object) -> JsonDict:
    """Return the property of a number, or with ``array`` of a list of numbers."""
    told: JsonDict = {"componentType": component, "description": description, "required": True}
    return {**_SCALAR_PROPERTY, **told, **members}


def metadata_schema(*, has_origin: bool = False) -> JsonDict:
    """Return the metadata schema (3D Metadata Specification 1.0) of an explicit tileset."""
    optional: JsonDict = {"array": True, "required": False}
    tile = {
        "bytes": _number(
            "UINT32", "Bytes of the content at each quality, finest first.", array=True
        ),
        "cell": _number("FLOAT32", "Side of the cells in which splats were merged; 0 for a leaf."),
        "error": _number(
            "FLOAT32", "Geometric error of drawing the content at each quality.", **optional
        ),
        "splats": _number("UINT32", "How many splats the content has."),
        FILES_PROPERTY: {**_FILES, "required": False},
        "worth": _number(
            "FLOAT32", "What drawing the content is worth at each quality, 0 to 1.", **optional
        ),
    }
    tileset = {
        "quality": _number("UINT8", 'Which of the sizes in "bytes" is that of the contents.'),
        "sh_degree": _number("UINT8", "Highest degree of spherical harmonics in the contents."),
        "source_splats": _number("UINT64", "How many splats the scene has: all leaves together."),
    }
    if has_origin:
        tileset["origin"] = {
            "type": "VEC3",
            "componentType": "FLOAT64",
            "description": "The point of the scene that is 0, 0, 0 in the frame of the root tile.",
        }
    return {
        "id": "gsgen_tiles",
        "classes": {TILE_CLASS: {"properties": tile}, TILESET_CLASS: {"properties": tileset}},
    }


def implicit_metadata_schema(*, has_origin: bool = False, quality_count: int = 1) -> JsonDict:
    """Return the metadata schema of an implicit tileset, whose subtrees have property tables."""
    row = {"array": True, "count": quality_count} if quality_count > 1 else {}
    box = {"array": True, "componentType": "FLOAT64", "count": 12, **_SCALAR_PROPERTY}
    schema = metadata_schema(has_origin=has_origin)
    properties = {
        "box": {**box, "required": True, "semantic": "TILE_BOUNDING_BOX"},
        "bytes": {**_SCALAR_PROPERTY, **row, "componentType": "UINT32", "required": True},
        "cell": {**_SCALAR_PROPERTY, "componentType": "FLOAT32", "required": True},
        "error": {**_SCALAR_PROPERTY, **row, "componentType": "FLOAT32", "required": True},
        "geometric_error": {
            **_SCALAR_PROPERTY,
            "componentType": "FLOAT64",
            "required": True,
            "semantic": "TILE_GEOMETRIC_ERROR",
        },
        "splats": {**_SCALAR_PROPERTY, "componentType": "UINT32", "required": True},
        "worth": {**_SCALAR_PROPERTY, **row, "componentType": "FLOAT32", "required": True},
    }
    schema["classes"][TILESET_CLASS]["properties"][FILES_PROPERTY] = _FILES
    content = {"content_box": {**box, "required": True, "semantic": "CONTENT_BOUNDING_BOX"}}
    schema["classes"][TILE_CLASS] = {"properties": properties}
    schema["classes"][f"{TILE_CLASS}_content"] = {"properties": content}
    return schema

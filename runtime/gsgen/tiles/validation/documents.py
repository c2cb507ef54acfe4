"""Checks the JSON of ``tileset.json`` files: members by JSON Schema, then what they refer to."""

__all__ = ["check_document", "check_subtree"]

import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.format.extensions import CONTENT_EXTENSION
from gsgen.tiles.format.json_values import JsonObject, shorten
from gsgen.tiles.format.schema import (
    METADATA_SCHEMA,
    SUBTREE_SCHEMA,
    TILE_SCHEMA,
    TILESET_SCHEMA,
    Schema,
)
from gsgen.tiles.validation.metadata import check_entity, check_metadata_schema, check_statistics

if TYPE_CHECKING:
    from jsonschema import Draft202012Validator, ValidationError

_TEMPLATE_VARIABLE: Final = re.compile(r"\{([^{}]*)\}")
_GLTF_SUFFIXES: Final = (".glb", ".gltf")
_EXPECTED_BY_KEYWORD: Final = {
    "type": "a value of type {}",
    "minimum": "{} or more",
    "minItems": "{} entries or more",
    "maxItems": "{} entries or fewer",
    "minLength": "{} characters or more",
    "minProperties": "{} members or more",
    "pattern": "text that matches {}",
}


def check_document(document: JsonObject, schema: JsonObject | None) -> Iterator[TilesetInvalid]:
    """Yield what a ``tileset.json`` has against 3D Tiles 1.1, and against its own declarations.

    Args:
        document: The file.
        schema: Its metadata schema, which may stand in another file; None without one.
    """
    yield from _schema_faults(document, TILESET_SCHEMA)
    faults = list(_metadata_schema_faults(schema)) if schema else []
    yield from faults
    yield from _range_faults(document)
    yield from _extension_faults(document)
    is_comparable = not faults  # with a wrong schema, nothing that refers to it is compared
    groups = document.values.get("groups")
    groups = groups if isinstance(groups, list) else []
    if is_comparable:
        for number, group in enumerate(groups):
            if isinstance(group, dict):
                yield from check_entity(
                    JsonObject(group, f"{document.at('groups')}[{number}]"), schema
                )
        yield from _metadata_faults(document, schema)
        yield from check_statistics(document, schema)
    for tile in _tiles(document):
        faults = list(_schema_faults(tile, TILE_SCHEMA))
        yield from faults
        if faults:
            continue
        for entry in [tile, *_contents(tile)] if is_comparable else ():
            yield from _metadata_faults(entry, schema)
        for content in _contents(tile):
            if content.values.get("group", -1) >= len(groups):
                yield _fault(content, "group", f"less than the {len(groups)} groups")
        if "implicitTiling" in tile:
            yield from _implicit_faults(tile)


def _metadata_schema_faults(schema: JsonObject) -> Iterator[TilesetInvalid]:
    faults = list(_schema_faults(schema, METADATA_SCHEMA))
    yield from faults or check_metadata_schema(schema)


def check_subtree(document: JsonObject) -> Iterator[TilesetInvalid]:
    """Yield what the JSON of a subtree has against 3D Tiles 1.1."""
    yield from _schema_faults(document, SUBTREE_SCHEMA)


def _schema_faults(entry: JsonObject, schema: Schema) -> Iterator[TilesetInvalid]:
    """Yield the keywords of a JSON Schema that an object breaks."""
    for error in _validator(id(schema)).iter_errors(entry.values):
        yield _from_schema_error(entry, error)


@cache
def _validator(schema_id: int) -> "Draft202012Validator":
    from jsonschema import Draft202012Validator  # a sixth of a second: only where it is needed

    schemas = (TILESET_SCHEMA, TILE_SCHEMA, METADATA_SCHEMA, SUBTREE_SCHEMA)
    return Draft202012Validator({id(schema): schema for schema in schemas}[schema_id])


def _from_schema_error(entry: JsonObject, error: "ValidationError") -> TilesetInvalid:
    """Convert an error of jsonschema to a fault with location, actual and expected value."""
    keyword, bound = str(error.validator), error.validator_value
    path = list(error.absolute_path)
    actual, expected = shorten(error.instance), str(error.schema.get("description", ""))
    if keyword == "required":
        path.append(error.message.split("'")[1])
        actual, expected = "the member is missing", "the member, which 3D Tiles requires"
    elif keyword == "enum":
        expected = f"one of {', '.join(map(str, bound))}"
    elif not expected:
        expected = _EXPECTED_BY_KEYWORD.get(keyword, f"{keyword} {{}}").format(bound)
    return TilesetInvalid(
        actual, location=_location(entry, path), expected=expected, fault=entry.fault
    )


def _location(entry: JsonObject, path: list[str | int]) -> str:
    location = entry.location
    for key in path:
        if isinstance(key, int):
            location += f"[{key}]"
        else:
            location += f"{key}" if location.endswith(", ") else f".{key}"
    return location.removesuffix(", ")


def _fault(entry: JsonObject, key: str, expected: str) -> TilesetInvalid:
    return TilesetInvalid(shorten(entry.values[key]), location=entry.at(key), expected=expected)


def _metadata_faults(entry: JsonObject, schema: JsonObject | None) -> Iterator[TilesetInvalid]:
    if isinstance(entry.values.get("metadata"), dict):
        yield from check_entity(entry.child("metadata"), schema)


def _tiles(document: JsonObject) -> Iterator[JsonObject]:
    """Yield the tiles of a ``tileset.json``, as far as they are objects."""
    root = document.values.get("root")
    pending = [JsonObject(root, document.at("root"))] if isinstance(root, dict) else []
    while pending:
        tile = pending.pop()
        yield tile
        children = tile.values.get("children")
        for number, child in enumerate(children if isinstance(children, list) else ()):
            if isinstance(child, dict):
                pending.append(JsonObject(child, f"{tile.at('children')}[{number}]"))


def _contents(tile: JsonObject) -> Iterator[JsonObject]:
    if "content" in tile:
        yield tile.child("content")
    yield from tile.objects("contents")


def _range_faults(document: JsonObject) -> Iterator[TilesetInvalid]:
    """Yield ranges of properties of version 1.0 whose minimum exceeds their maximum."""
    ranges = document.values.get("properties")
    for name, entry in ranges.items() if isinstance(ranges, dict) else ():
        low, high = (
            entry.get(key) if isinstance(entry, dict) else None for key in ("minimum", "maximum")
        )
        if isinstance(low, int | float) and isinstance(high, int | float) and low > high:
            location = f"{document.at('properties')}.{name}"
            yield TilesetInvalid(
                f"minimum {low!r:.40}",
                location=location,
                expected=f"the maximum {high!r:.40} or less",
            )


def _extension_faults(document: JsonObject) -> Iterator[TilesetInvalid]:
    """Yield extensions that the file contains or needs, and does not declare."""
    for key in ("extensionsUsed", "extensionsRequired"):
        # jsonschema's own test of unique entries takes the square of their number.
        entries = document.values.get(key)
        if isinstance(entries, list) and len(set(map(str, entries))) < len(entries):
            yield _fault(document, key, "every entry once")
    declared = document.values.get("extensionsUsed", [])
    names = set(map(str, declared)) if isinstance(declared, list) else set()
    missing = dict.fromkeys(name for name in _extension_names(document.values) if name not in names)
    if missing:
        yield TilesetInvalid(
            f"extensionsUsed lacks {shorten(list(missing))}",
            location=document.at("extensionsUsed"),
            expected="the name of every extension of the file",
        )
    asset = document.values.get("asset")
    if isinstance(asset, dict) and asset.get("version") == "1.0" and CONTENT_EXTENSION not in names:
        for tile in _tiles(document):
            content = tile.values.get("content")
            uri = content.get("uri", "") if isinstance(content, dict) else ""
            if isinstance(uri, str) and uri.lower().endswith(_GLTF_SUFFIXES):
                yield TilesetInvalid(
                    f"{shorten(uri)} in a tileset of version 1.0",
                    location=tile.at("content"),
                    expected=f"version 1.1, or extensionsUsed with {CONTENT_EXTENSION}",
                )
                return


def _extension_names(value: object) -> Iterator[str]:
    """Yield the names of extensions in a JSON value, except in members ``extras``."""
    pending = [value]
    while pending:
        entry = pending.pop()
        if isinstance(entry, list):
            pending += entry
        if not isinstance(entry, dict):
            continue
        extensions = entry.get("extensions")
        if isinstance(extensions, Mapping):
            yield from map(str, extensions)
        pending += [part for key, part in entry.items() if key not in ("extras", "extensions")]


def _implicit_faults(tile: JsonObject) -> Iterator[TilesetInvalid]:
    """Yield what the root of an implicit tree must not have, and wrong variables of its uris."""
    for key in ("children", "metadata"):
        if key in tile:
            yield _fault(tile, key, "no such member beside implicitTiling")
    entry = tile.child("implicitTiling")
    axes = ("x", "y") if entry.values["subdivisionScheme"] == "QUADTREE" else ("x", "y", "z")
    yield from _template_faults(entry.child("subtrees"), ("level", *axes))
    for content in _contents(tile):
        if "boundingVolume" in content:
            yield _fault(content, "boundingVolume", "no such member beside implicitTiling")
        yield from _template_faults(content, ("level", *axes))


def _template_faults(entry: JsonObject, names: tuple[str, ...]) -> Iterator[TilesetInvalid]:
    uri: Any = entry.values.get("uri")
    if isinstance(uri, str) and sorted(set(_TEMPLATE_VARIABLE.findall(uri))) != sorted(names):
        text = ", ".join(f"{{{name}}}" for name in names)
        yield _fault(entry, "uri", f"a uri with the variables {text}")

"""Members of ``tileset.json``: each fault is named where it stands, and right files have none."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from gsgen.contract import Level
from gsgen.contract.validation.settings import Settings
from gsgen.tiles.format import schema as schemas
from gsgen.tiles.format.json_values import JsonObject
from gsgen.tiles.validation.documents import check_document, check_subtree
from gsgen.tiles.validation.sketches import explicit_sketch, implicit_sketch
from gsgen.tiles.validation.validate import validate

BOX = [0.5, 0.5, 0.5, 0.5, 0, 0, 0, 0.5, 0, 0, 0, 0.5]
DOCUMENT: dict[str, Any] = {
    "asset": {"version": "1.1", "tilesetVersion": "3"},
    "geometricError": 4,
    "properties": {"height": {"minimum": 1, "maximum": 2}},
    "extensionsUsed": ["EXAMPLE_a"],
    "extensions": {"EXAMPLE_a": {}},
    "schema": {
        "id": "example",
        "classes": {
            "house": {
                "properties": {
                    "height": {
                        "type": "SCALAR",
                        "componentType": "UINT8",
                        "normalized": True,
                        "scale": 10,
                        "offset": 1,
                        "min": 1,
                        "max": 6,
                    },
                    "name": {"type": "STRING", "required": True, "semantic": "NAME"},
                    "roof": {"type": "ENUM", "enumType": "roofs", "noData": "none"},
                    "corner": {
                        "type": "VEC2",
                        "componentType": "FLOAT32",
                        "array": True,
                        "count": 2,
                        "max": [[5, 5], [9, 9]],
                    },
                    "tags": {"type": "BOOLEAN", "array": True},
                    "level": {"type": "SCALAR", "componentType": "INT16", "default": 3},
                }
            },
            "street": {},
        },
        "enums": {
            "roofs": {"values": [{"name": "none", "value": 0}, {"name": "flat", "value": 9}]}
        },
    },
    "groups": [{"class": "street"}],
    "statistics": {
        "classes": {
            "house": {
                "count": 2,
                "properties": {
                    "height": {"min": 1, "max": 5},
                    "roof": {"occurrences": {"flat": 2}},
                },
            }
        }
    },
    "root": {
        "refine": "ADD",
        "geometricError": 2,
        "boundingVolume": {"box": BOX},
        "viewerRequestVolume": {"sphere": [0, 0, 0, 9]},
        "metadata": {
            "class": "house",
            "properties": {
                "height": 100,
                "name": "a",
                "roof": "flat",
                "corner": [[1, 2], [8, 9]],
                "tags": [True, False, True],
            },
        },
        "content": {"uri": "a.glb", "group": 0, "boundingVolume": {"region": [0, 0, 1, 1, 0, 9]}},
        "children": [
            {"geometricError": 0, "boundingVolume": {"box": BOX}, "contents": [{"uri": "b.glb"}]}
        ],
    },
}
IMPLICIT = {
    "subdivisionScheme": "QUADTREE",
    "subtreeLevels": 2,
    "availableLevels": 3,
    "subtrees": {"uri": "{level}/{x}/{y}.subtree"},
}
LACKING = object()
COLUMNS = "schema.classes.house.properties"

# Path of a member, its new value (LACKING: none), and the location of the fault where it is not
# the member itself.
FAULTS: list[tuple[str, object, str]] = [
    # the file
    ("asset.tilesetVersion", 3, ""),
    ("asset.version", LACKING, ""),
    ("geometricError", -1, ""),
    ("schemaUri", "schema.json", "tileset.json"),
    ("extensionsUsed", [], ""),
    ("extensionsUsed", ["EXAMPLE_a", "EXAMPLE_a"], ""),
    ("extensionsUsed", LACKING, ""),
    ("extensionsUsed", ["EXAMPLE_b"], ""),
    ("root.extensions", {"EXAMPLE_c": {}}, "extensionsUsed"),
    ("extensionsRequired", [], ""),
    ("extensionsRequired", "EXAMPLE_a", ""),
    ("extensions.EXAMPLE_a", "text", ""),
    ("properties", [], ""),
    ("properties.height.minimum", LACKING, ""),
    ("properties.height.maximum", "2", ""),
    ("properties.height.minimum", 3, "properties.height"),
    ("properties.height.minimum", 10**400, "properties.height"),
    (f"{COLUMNS}.height.max", 10**400, ""),
    # groups and statistics
    ("groups", [], ""),
    ("groups[0].class", 1.5, ""),
    ("groups[0].class", "path", ""),
    ("groups[0].class", LACKING, ""),
    ("schema", LACKING, "groups[0].class"),
    ("statistics.classes", {}, ""),
    ("statistics.classes", [], ""),
    ("statistics.classes.path", {}, "statistics.classes"),
    ("statistics.classes.house", 1, ""),
    ("statistics.classes.house.count", -1, ""),
    ("statistics.classes.house.properties", {}, ""),
    ("statistics.classes.house.properties.width", {}, "statistics.classes.house.properties"),
    ("statistics.classes.house.properties.height.min", "1", ""),
    # the metadata schema
    ("schema.id", LACKING, ""),
    ("schema.id", "an id", ""),
    ("schema.classes.a-b", {}, "schema.classes"),
    ("schema.classes.street.properties", {}, ""),
    ("schema.enums.roofs.values", [], ""),
    ("schema.enums.roofs.values[1].name", "none", ""),
    ("schema.enums.roofs.values[1].value", 0, ""),
    ("schema.enums.roofs.values[1].value", 65536, ""),
    ("schema.enums.roofs.valueType", "FLOAT32", ""),
    (f"{COLUMNS}.height.type", "VEC5", ""),
    (f"{COLUMNS}.height.componentType", LACKING, ""),
    (f"{COLUMNS}.height.componentType", "FLOAT32", f"{COLUMNS}.height.normalized"),
    (f"{COLUMNS}.height.count", 2, ""),
    (f"{COLUMNS}.height.scale", [1, 2], ""),
    (f"{COLUMNS}.height.enumType", "roofs", ""),
    (f"{COLUMNS}.name.componentType", "UINT8", ""),
    (f"{COLUMNS}.name.min", 1, ""),
    (f"{COLUMNS}.name.default", "b", ""),
    (f"{COLUMNS}.name.semantic", "TILE_BOUNDING_BOX", ""),
    (f"{COLUMNS}.roof.enumType", "walls", ""),
    (f"{COLUMNS}.roof.enumType", LACKING, ""),
    (f"{COLUMNS}.roof.noData", "steep", ""),
    (f"{COLUMNS}.roof.semantic", "NAME", ""),
    (f"{COLUMNS}.corner.count", 1, ""),
    (f"{COLUMNS}.corner.max", [5, 9], ""),
    (f"{COLUMNS}.corner.count", LACKING, f"{COLUMNS}.corner.max"),
    (f"{COLUMNS}.tags.noData", [True], ""),
    (f"{COLUMNS}.level.default", 40000, ""),
    (f"{COLUMNS}.level.offset", 1, ""),
    # tiles and contents
    ("root.refine", LACKING, ""),
    ("root.refine", "add", ""),
    ("root.boundingVolume", {}, ""),
    ("root.boundingVolume.box", BOX[:11], ""),
    ("root.boundingVolume.box[3]", "0.5", ""),
    ("root.viewerRequestVolume.sphere", [0, 0, 0], ""),
    ("root.transform", [1] * 15, ""),
    ("root.content.uri", LACKING, "root.content"),
    ("root.content.group", 1, ""),
    ("root.content.group", -1, ""),
    ("root.content.boundingVolume.region", 1, ""),
    ("root.children", [], ""),
    ("root.children[0].geometricError", LACKING, ""),
    ("root.children[0].contents", [], ""),
    ("root.children[0].metadata", {"class": "path"}, "root.children[0].metadata.class"),
    # entities
    ("root.metadata.class", LACKING, ""),
    ("root.metadata.properties.width", 1, ""),
    ("root.metadata.properties.name", LACKING, ""),
    ("root.metadata.properties.name", None, ""),
    ("root.metadata.properties.name", 1, ""),
    ("root.metadata.properties.height", 256, ""),
    ("root.metadata.properties.height", 200, ""),
    ("root.metadata.properties.height", 1.5, ""),
    ("root.metadata.properties.roof", "steep", ""),
    ("root.metadata.properties.corner", [[1, 2]], ""),
    ("root.metadata.properties.corner", [[1, 2], [8, 10]], ""),
    ("root.metadata.properties.tags", [1], ""),
]
IMPLICIT_FAULTS: list[tuple[str, object, str]] = [
    ("root.implicitTiling.subdivisionScheme", "BINARY", ""),
    ("root.implicitTiling.subtreeLevels", 0, ""),
    ("root.implicitTiling.availableLevels", LACKING, "root.implicitTiling"),
    ("root.implicitTiling.subtrees.uri", "{level}/{x}.subtree", ""),
    ("root.implicitTiling.subtrees.uri", "{level}/{x}/{y}/{w}.subtree", ""),
    ("root.content.uri", "a.glb", ""),
    ("root.content.boundingVolume", {"box": BOX}, ""),
    ("root.metadata", {"class": "street"}, ""),
    ("root.children", [{"geometricError": 0, "boundingVolume": {"box": BOX}}], ""),
]


def edited(document: dict[str, Any], path: str, value: object) -> dict[str, Any]:
    result = copy.deepcopy(document)
    *parents, last = (
        int(key) if key.isdigit() else key
        for key in path.replace("]", "").replace("[", ".").split(".")
    )
    target: Any = result
    for key in parents:
        target = target[key]
    if value is LACKING:
        del target[last]
    else:
        target[last] = value
    return result


def implicit_document() -> dict[str, Any]:
    document = copy.deepcopy(DOCUMENT)
    root = document["root"]
    for key in ("children", "metadata"):
        del root[key]
    root |= {"implicitTiling": IMPLICIT, "content": {"uri": "{level}/{x}/{y}.glb"}}
    return document


def locations(document: dict[str, Any]) -> list[str]:
    entry = JsonObject(document, "tileset.json, ")
    return [fault.location for fault in check_document(entry, entry.optional("schema"))]


@pytest.mark.parametrize("document", [DOCUMENT, implicit_document()], ids=["explicit", "implicit"])
def test_document_with_all_members_has_no_fault(document: dict[str, Any]) -> None:
    assert locations(document) == []


@pytest.mark.parametrize(
    ("path", "value", "location"),
    FAULTS,
    ids=lambda value: "lacking" if value is LACKING else f"{value}"[-40:],
)
def test_fault_of_a_member_is_named_where_it_stands(
    path: str, value: object, location: str
) -> None:
    found = locations(edited(DOCUMENT, path, value))
    assert (
        location if location == "tileset.json" else f"tileset.json, {location or path}"
    ) in found


@pytest.mark.parametrize(("path", "value", "location"), IMPLICIT_FAULTS)
def test_fault_of_an_implicit_root_is_named_where_it_stands(
    path: str, value: object, location: str
) -> None:
    found = locations(edited(implicit_document(), path, value))
    assert f"tileset.json, {location or path}" in found


@pytest.mark.parametrize(
    ("path", "value", "location"),
    [
        ("buffers", [], "buffers"),
        ("bufferViews", LACKING, ""),
        ("contentAvailability", [], "contentAvailability"),
        ("propertyTables", [], "propertyTables"),
        ("tileAvailability", {}, "tileAvailability"),
        ("tileAvailability.constant", 1, "tileAvailability"),
        ("childSubtreeAvailability", LACKING, "childSubtreeAvailability"),
    ],
)
def test_fault_of_a_subtree_is_named_where_it_stands(
    path: str, value: object, location: str
) -> None:
    document: dict[str, Any] = {
        "buffers": [{"byteLength": 8}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 1}],
        "tileAvailability": {"bitstream": 0},
        "contentAvailability": [{"constant": 0}],
        "childSubtreeAvailability": {"constant": 0},
    }
    assert list(check_subtree(JsonObject(document, "a, "))) == []
    found = [
        fault.location for fault in check_subtree(JsonObject(edited(document, path, value), "a, "))
    ]
    assert found == [f"a, {location}" if location else "a"]


def test_gltf_in_version_1_0_needs_the_extension() -> None:
    document = edited(DOCUMENT, "asset.version", "1.0")
    assert locations(document) == ["tileset.json, root.content"]
    declared = edited(document, "extensionsUsed", ["EXAMPLE_a", "3DTILES_content_gltf"])
    assert locations(declared) == []


def test_members_within_extras_are_not_looked_at() -> None:
    assert locations(edited(DOCUMENT, "root.extras", {"extensions": {"EXAMPLE_d": {}}})) == []


HUGE = st.sampled_from([10**400, -(10**400), 1e999, -1e999])
VALUES = st.one_of(
    HUGE, st.lists(HUGE, max_size=2),
    st.none(), st.booleans(), st.integers(-3, 300), st.floats(-2, 2), st.text(max_size=3),
    st.lists(st.integers(0, 2), max_size=3), st.dictionaries(st.text(max_size=2), st.none()),
)  # fmt: skip


def paths(value: object, prefix: str = "") -> list[str]:
    members = value.items() if isinstance(value, dict) else ()
    found = [f"{prefix}.{key}".lstrip(".") for key, _ in members]
    for key, member in members:
        found += paths(member, f"{prefix}.{key}".lstrip("."))
    return found


@given(path=st.sampled_from(paths(DOCUMENT)), value=st.one_of(VALUES, st.just(LACKING)))
@settings(max_examples=400, deadline=None)
def test_any_value_of_any_member_is_judged_without_a_traceback(path: str, value: object) -> None:
    document = edited(DOCUMENT, path, value)
    entry = JsonObject(document, "tileset.json, ")
    schema = document.get("schema")
    metadata = JsonObject(schema, entry.at("schema")) if isinstance(schema, dict) else None
    for fault in check_document(entry, metadata):
        assert fault.location
        assert fault.expected


@pytest.mark.parametrize("name", ["TILESET", "TILE", "METADATA", "SUBTREE"])
def test_schemas_are_schemas(name: str) -> None:
    Draft202012Validator.check_schema(getattr(schemas, f"{name}_SCHEMA"))


def write_with(folder: Path, edit: Callable[[dict[str, Any]], None]) -> Path:
    sketch = explicit_sketch(record=False)
    edit(sketch.document)
    path = folder / "tileset.json"
    sketch.write(path)
    return path


def rules_broken(path: Path) -> set[str]:
    return {finding.rule for finding in validate(path, Settings(level=Level.STATIC)).findings}


def write_outer(folder: Path, inner: dict[str, Any], error: float) -> Path:
    """Write a tileset whose only leaf names ``inner``, which has an error of 1 at its root."""
    volume = {"sphere": [0, 0, 0, 99]}
    child = {"geometricError": 0.5, "boundingVolume": volume, "content": {"uri": "inner.json"}}
    root = {"refine": "ADD", "geometricError": error, "boundingVolume": volume, "children": [child]}
    outer = {**inner, "geometricError": 99, "root": root}
    del outer["metadata"]
    (folder / "inner.json").write_text(json.dumps(inner))
    path = folder / "outer.json"
    path.write_text(json.dumps(outer))
    return path


def test_external_root_without_refine_breaks_gt001(tmp_path: Path) -> None:
    write_with(tmp_path, lambda document: None)
    inner = json.loads((tmp_path / "tileset.json").read_text())
    assert rules_broken(write_outer(tmp_path, inner, 5)) == set()
    del inner["root"]["refine"]
    assert rules_broken(write_outer(tmp_path, inner, 5)) == {"GT001"}


def test_error_of_an_external_root_is_compared_with_what_is_drawn_above(tmp_path: Path) -> None:
    write_with(tmp_path, lambda document: None)
    inner = json.loads((tmp_path / "tileset.json").read_text())
    assert rules_broken(write_outer(tmp_path, inner, 0.6)) == {"GT004"}


def test_content_outside_its_tile_breaks_gt002(tmp_path: Path) -> None:
    def enlarge(document: dict[str, Any]) -> None:
        document["root"]["children"][0]["content"]["boundingVolume"]["box"][3] *= 9

    assert "GT002" in rules_broken(write_with(tmp_path, enlarge))


def test_uneven_scale_breaks_gt011_where_splats_are(tmp_path: Path) -> None:
    def scale(document: dict[str, Any]) -> None:
        document["root"]["transform"] = [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]

    assert "GT011" in rules_broken(write_with(tmp_path, scale))


def test_glb_with_bytes_after_its_end_breaks_gt005(tmp_path: Path) -> None:
    path = write_with(tmp_path, lambda document: None)
    assert rules_broken(path) == set()
    content = next(tmp_path.rglob("*.glb"))
    content.write_bytes(content.read_bytes() + b"\0\0\0\0")
    assert rules_broken(path) >= {"GT005"}


def test_subtree_without_buffer_views_breaks_gt013(tmp_path: Path) -> None:
    sketch = implicit_sketch()
    path = tmp_path / "tileset.json"
    sketch.write(path)
    assert rules_broken(path) == set()
    subtree = next(tmp_path.rglob("*.subtree"))
    data = subtree.read_bytes()
    subtree.write_bytes(data.replace(b'"bufferViews"', b'"bufferView5"'))
    assert rules_broken(path) >= {"GT013"}

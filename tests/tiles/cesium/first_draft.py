"""Tilesets as CesiumJS's own tests have them: the first draft of KHR_gaussian_splatting.

The layouts are those of the folder ``Specs/Data/Cesium3DTiles/GaussianSplats`` of CesiumJS
(github.com/CesiumGS/cesium, Apache-2.0): ``synthetic``, whose five splats follow from formulas,
and ``tower`` and ``tower_legacy``, which stand on the globe. Nothing here is copied from there.
"""

import base64
import json

import numpy as np

from support.tiles.foreign_tiles import east_north_up

COLORS = np.column_stack(
    [[127, 134, 141, 149, 156], [199, 206, 213, 221, 228], [255] * 5, [140, 152, 164, 175, 186]]
).astype(np.uint8)
"""Red, green, blue and opacity of the five splats, as bytes."""

_CENTER = [2.0, 7.0, 12.0]


def five_splats() -> dict[str, bytes]:
    """Five splats on a diagonal: colours are bytes, and no colour space is declared."""
    steps = np.arange(5)
    turns = np.column_stack([0.1 * steps, 0.2 * steps, 0.3 * steps, np.ones(5)])  # x y z w
    columns = {
        "POSITION": np.repeat(steps[:, None] - 2.0, 3, axis=1),
        "_SCALE": np.repeat(np.exp(1 + 0.1 * steps)[:, None], 3, axis=1),
        "_ROTATION": turns / np.linalg.norm(turns, axis=1, keepdims=True),
        "COLOR_0": COLORS,
    }
    body, views, accessors = b"", [], []
    for name, values in columns.items():
        data = values.tobytes() if name == "COLOR_0" else values.astype("<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(data)})
        accessor = {"bufferView": len(views) - 1, "componentType": 5126, "count": 5}
        if name == "COLOR_0":
            accessor |= {"componentType": 5121, "normalized": True}
        accessors.append(accessor | {"type": f"VEC{values.shape[1]}"})
        body += data
    accessors[0] |= {"min": [-2.0] * 3, "max": [2.0] * 3}
    uri = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
    primitive = {
        "attributes": {name: index for index, name in enumerate(columns)},
        "extensions": {"KHR_gaussian_splatting": {}},
        "material": 0,
        "mode": 0,
    }
    x, y, z = _CENTER
    content = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit", "KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        # A quarter turn about x, which undoes that of the viewer, and the centre in glTF's axes.
        "nodes": [{"matrix": [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, x, z, -y, 1], "mesh": 0}],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(body), "uri": uri}],
    }
    index = {
        "asset": {"version": "1.1"},
        "geometricError": 6.93,
        "root": _root([*_CENTER, *(2.001 * np.eye(3)).ravel().tolist()], "0/0.gltf"),
    }
    return {"tileset.json": _json(index), "0/0.gltf": _json(content)}


def tower(*, is_legacy: bool) -> dict[str, object]:
    """The index of a tileset on the globe, whose box is far from the origin of its frame."""
    names = (
        ["KHR_spz_gaussian_splats_compression"]
        if is_legacy
        else ["KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"]
    )
    degrees, height = ((8.27, 46.02), 187.0) if is_legacy else ((-93.17, 44.51), 2566.0)
    half = np.diag([2.4, 2.6, 6.5] if is_legacy else [8.4, 8.1, 36.6])
    root = _root([1.0, -1.5, height, *half.ravel().tolist()], "0/0.glb")
    return {
        "asset": {"version": "1.1", "extras": {"ion": {"georeferenced": True}}},
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": {
            "3DTILES_content_gltf": {"extensionsUsed": names, "extensionsRequired": names}
        },
        "geometricError": 77.0,
        "root": root | {"transform": east_north_up(*degrees, 0.0).T.ravel().tolist()},
    }


def _root(box: list[float], uri: str) -> dict[str, object]:
    return {
        "boundingVolume": {"box": box},
        "content": {"uri": uri},
        "geometricError": 0.0,
        "refine": "REPLACE",
    }


def _json(document: dict[str, object]) -> bytes:
    return json.dumps(document).encode()

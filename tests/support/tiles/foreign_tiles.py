"""Tilesets of others, written by code that shares nothing with the project's own writer.

Contents are written attribute by attribute from the specification of KHR_gaussian_splatting,
and SPZ byte by byte from its layout; positions on the globe are computed in extended precision.
"""

import base64
import gzip
import json
import math
import struct
from pathlib import Path

import numpy as np

COUNT = 40


def cloud(seed: int, count: int = COUNT, degree: int = 0) -> dict[str, np.ndarray]:
    """Splats in the axes of a glTF file: y up."""
    rng = np.random.default_rng(seed)
    rotation = rng.normal(size=(count, 4))
    return {
        "position": rng.uniform(-20, 20, (count, 3)),
        "rotation": rotation / np.linalg.norm(rotation, axis=1, keepdims=True),  # xyzw
        "scale": rng.uniform(0.02, 0.3, (count, 3)),
        "opacity": rng.uniform(0.1, 0.95, count),
        "sh": rng.normal(0, 0.2, (count, (degree + 1) ** 2, 3)),
    }


def gltf(
    splats: dict[str, np.ndarray],
    *,
    matrix: np.ndarray | None = None,
    drafts: bool = False,
    embedded: bool = False,
) -> bytes:
    """A .glb, or a .gltf whose buffer is a data URI."""
    prefix = "" if drafts else "KHR_gaussian_splatting:"
    columns: dict[str, np.ndarray] = {"POSITION": splats["position"]}
    rotation, scale = ("_ROTATION", "_SCALE") if drafts else ("ROTATION", "SCALE")
    columns[prefix + rotation] = splats["rotation"]
    columns[prefix + scale] = splats["scale"]
    if drafts:
        color = splats["sh"][:, 0] * 0.28209479177387814 + 0.5
        columns["COLOR_0"] = np.column_stack([color, splats["opacity"]])
    else:
        columns[prefix + "OPACITY"] = splats["opacity"]
        degree = math.isqrt(splats["sh"].shape[1]) - 1
        offset = 0
        for band in range(degree + 1):
            for index in range(2 * band + 1):
                columns[f"{prefix}SH_DEGREE_{band}_COEF_{index}"] = splats["sh"][:, offset]
                offset += 1
    body, views, accessors, attributes = b"", [], [], {}
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    for name, values in columns.items():
        table = np.asarray(values, "<f4").reshape(len(splats["position"]), -1)
        attributes[name] = len(accessors)
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": table.nbytes})
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": 5126,
                "count": len(table),
                "type": kinds[table.shape[1]],
            }
        )
        body += table.tobytes()
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    node: dict[str, object] = {"mesh": 0}
    if matrix is not None:
        node["matrix"] = matrix.T.ravel().tolist()
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [
            {
                "primitives": [
                    {
                        "mode": 0,
                        "attributes": attributes,
                        "extensions": {"KHR_gaussian_splatting": extension},
                    }
                ]
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    if embedded:
        uri = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
        document["buffers"] = [{"byteLength": len(body), "uri": uri}]
        return json.dumps(document).encode()
    return glb(document, body)


def glb(document: dict[str, object], body: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body += bytes(-len(body) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def spz_glb(
    splats: dict[str, np.ndarray], matrix: np.ndarray | None = None, *, drafts: bool = False
) -> bytes:
    """A .glb with SPZ 2 of degree 0, twelve fractional bits."""
    count = len(splats["position"])
    parts = [struct.pack("<IIIBBBB", 0x5053474E, 2, count, 0, 12, 0, 0)]
    for row in np.rint(splats["position"] * 4096).astype(int):
        for value in row:
            parts.append(int(value).to_bytes(3, "little", signed=True))
    parts.append(bytes(round(float(v) * 255) for v in splats["opacity"]))
    dc = np.clip(np.rint((splats["sh"][:, 0] * 0.15 + 0.5) * 255), 0, 255).astype(np.uint8)
    parts.append(dc.tobytes())
    scale = np.rint((np.log(splats["scale"]) + 10) * 16).astype(np.uint8)
    parts.append(scale.tobytes())
    signed = splats["rotation"] * np.where(splats["rotation"][:, 3:] < 0, -1, 1)
    turned = np.clip(np.rint(signed[:, :3] * 127.5 + 127.5), 0, 255).astype(np.uint8)
    parts.append(turned.tobytes())
    body = gzip.compress(b"".join(parts), mtime=0)
    names = ("KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2")
    extension = {"extensions": {names[1]: {"bufferView": 0}}, "kernel": "ellipse"}
    extension["colorSpace"] = "srgb_rec709_display"
    if drafts:
        names = ("KHR_spz_gaussian_splats_compression",)
        extension = {"bufferView": 0}
    accessor = {"componentType": 5126, "count": count, "type": "VEC3"}
    node: dict[str, object] = {"mesh": 0}
    if matrix is not None:
        node["matrix"] = matrix.T.ravel().tolist()
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": list(names),
        "extensionsRequired": list(names),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [
            {
                "primitives": [
                    {"mode": 0, "attributes": {"POSITION": 0}, "extensions": {names[0]: extension}}
                ]
            }
        ],
        "accessors": [accessor],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(body)}],
        "buffers": [{"byteLength": len(body)}],
    }
    return glb(document, body)


def turned_up(positions: np.ndarray) -> np.ndarray:
    """What a viewer makes of glTF coordinates: z up."""
    x, y, z = np.asarray(positions, np.longdouble).T
    return np.stack([x, -z, y], axis=1)


def moved_positions(positions: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    double_precision = np.asarray(matrix, np.longdouble)
    return (
        np.asarray(positions, np.longdouble) @ double_precision[:3, :3].T + double_precision[:3, 3]
    )


def east_north_up(longitude: float, latitude: float, height: float) -> np.ndarray:
    """The local frame at a point of the ellipsoid, in degrees and metres, as ECEF."""
    lon, lat = math.radians(longitude), math.radians(latitude)
    a, e2 = 6378137.0, 6.69437999014131699e-3
    n = a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    matrix = np.eye(4)
    matrix[:3, 0] = [-math.sin(lon), math.cos(lon), 0]
    matrix[:3, 1] = [-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)]
    up = [math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)]
    matrix[:3, 2] = up
    matrix[:3, 3] = [(n + height) * up[0], (n + height) * up[1], (n * (1 - e2) + height) * up[2]]
    return matrix


def box(reach: float, center: tuple[float, float, float] = (0, 0, 0)) -> dict[str, object]:
    return {"box": [*center, reach, 0, 0, 0, reach, 0, 0, 0, reach]}


GLTF = {
    "3DTILES_content_gltf": {
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "extensionsRequired": ["KHR_gaussian_splatting"],
    }
}
SPZ = {
    "3DTILES_content_gltf": {
        key: ["KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"]
        for key in ("extensionsUsed", "extensionsRequired")
    }
}


def tileset(root: dict[str, object], extensions: dict[str, object] = GLTF, **more: object) -> bytes:
    document = {
        "asset": {"version": "1.1"},
        "geometricError": 500,
        "extensions": extensions,
        "extensionsUsed": ["3DTILES_content_gltf"],
        "root": root,
        **more,
    }
    return json.dumps(document).encode()


def subtree(
    levels: int, branching: int, tiles: set[int], contents: set[int], children: set[int]
) -> bytes:
    """A binary subtree with two bitstreams in one buffer and one in another view."""

    def bits(members: set[int], count: int) -> bytes:
        data = bytearray((count + 7) // 8)
        for member in members:
            data[member // 8] |= 1 << member % 8
        return bytes(data)

    count = (branching**levels - 1) // (branching - 1)
    parts = [bits(tiles, count), bits(contents, count), bits(children, branching**levels)]
    body, views = b"", []
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(part)})
        body += part + bytes(-len(part) % 8)
    document = {
        "buffers": [{"byteLength": len(body)}],
        "bufferViews": views,
        "tileAvailability": {"bitstream": 0},
        "contentAvailability": [{"bitstream": 1}],
        "childSubtreeAvailability": {"bitstream": 2},
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<IIQQ", 0x74627573, 1, len(text), len(body)) + text + body


def write(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder / "tileset.json"

"""Scenes with coordinates of a map: files of several kinds, with exact float64 positions."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsgen.formats import Splats, write_glb, write_ply
from gsgen.formats.shared.splats import NO_ORIGIN

Origin = tuple[float, float, float]
FarWriter = Callable[[Path, Splats], Path]
"""Writes splats with an origin to a file in a folder, and returns the file."""


def far_splats(origin: Origin, count: int = 60, seed: int = 0) -> Splats:
    """Return opaque splats within ±2 units of a far point, with decimals."""
    rng = np.random.default_rng(seed)

    def draw(*shape: int, size: float) -> np.ndarray:
        return (size * rng.uniform(-1, 1, (count, *shape))).astype(np.float32)

    return Splats(
        position=draw(3, size=2.0),
        rotation=draw(4, size=1.0),
        log_scale=np.full((count, 3), np.log(0.08), np.float32),
        logit_opacity=np.full(count, 4.0, np.float32),
        sh=draw(1, 3, size=1.5),
        origin=origin,
    )


def write_double_ply(folder: Path, splats: Splats) -> Path:
    """Write a binary PLY file of doubles."""
    write_ply(folder / "double.ply", splats)
    return folder / "double.ply"


def write_big_endian_ply(folder: Path, splats: Splats) -> Path:
    """Write a big-endian PLY file of doubles."""
    write_ply(folder / "big.ply", splats, format="binary_big_endian")
    return folder / "big.ply"


def write_double_text(folder: Path, splats: Splats) -> Path:
    """Write a text PLY file that declares doubles."""
    write_ply(folder / "text.ply", splats, format="ascii")
    return folder / "text.ply"


def write_float_text(folder: Path, splats: Splats) -> Path:
    """Write a text PLY file that declares floats and prints more digits."""
    path = write_double_text(folder, splats)
    path.write_bytes(path.read_bytes().replace(b"property double", b"property float"))
    return path


def write_far_node(folder: Path, splats: Splats) -> Path:
    """Write a GLB file whose node is translated."""
    write_glb(folder / "node.glb", splats)
    return folder / "node.glb"


def _with_nodes(path: Path, nodes: list[dict[str, object]]) -> Path:
    """Replace the nodes of a GLB file; the first is the root."""
    content = path.read_bytes()
    (size,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + size])
    document["nodes"], document["scenes"] = nodes, [{"nodes": [0]}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    header = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    path.write_bytes(header + text + rest)
    return path


def write_matrix_node(folder: Path, splats: Splats) -> Path:
    """Write a GLB file whose node has a matrix with a far translation."""
    write_glb(folder / "matrix.glb", replace(splats, origin=NO_ORIGIN))
    x, y, z = splats.origin  # glTF is x left, y up
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -x, -y, z, 1]
    return _with_nodes(folder / "matrix.glb", [{"mesh": 0, "matrix": matrix}])


def write_nested_nodes(folder: Path, splats: Splats) -> Path:
    """Write a GLB file whose far translation is the sum of three nodes."""
    write_glb(folder / "nested.glb", replace(splats, origin=NO_ORIGIN))
    point = np.array(splats.origin) * (-1, -1, 1)
    parts = [2 * point, -1.5 * point, 0.5 * point]
    nodes: list[dict[str, object]] = [
        {"translation": part.tolist(), "children": [index + 1]} for index, part in enumerate(parts)
    ]
    del nodes[2]["children"]
    nodes[2]["mesh"] = 0
    return _with_nodes(folder / "nested.glb", nodes)


def write_scene_file(folder: Path, splats: Splats) -> Path:
    """Write a scene file that translates a file of small coordinates."""
    write_ply(folder / "near.ply", replace(splats, origin=NO_ORIGIN))
    entry = {"path": "near.ply", "translate": list(splats.origin)}
    scene = {"gsgen_scene": "1.0", "models": [entry]}
    (folder / "scene.json").write_text(json.dumps(scene), "utf-8")
    return folder / "scene.json"


FAR_FILES: dict[str, FarWriter] = {
    "PLY of doubles": write_double_ply,
    "big-endian PLY": write_big_endian_ply,
    "text of doubles": write_double_text,
    "text of floats": write_float_text,
    "GLB, far node": write_far_node,
    "GLB, matrix": write_matrix_node,
    "GLB, nested nodes": write_nested_nodes,
}
"""Writers of splat files with far coordinates."""

"""Meshes from files: GLB, glTF, OBJ, PLY and STL, read by trimesh."""

__all__ = ["is_mesh", "read_mesh"]

import json
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Literal, final

import numpy as np
from jaxtyping import Float, UInt8

from gsgen.contract.errors import GsgenError
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.scene.frame import srgb_of_linear
from gsgen.runtime.scene.mesh import Mesh, MeshData

SUFFIXES: Final = (".glb", ".gltf", ".obj", ".ply", ".stl")
"""How names of files that may hold meshes end."""

# glTF is x left, y up, z forward where our worlds, and PLY files, are x right, y down.
_FROM_GLTF: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
_SPLATS: Final = b"KHR_gaussian_splatting"
_PACKED: Final = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_texture_basisu",
)
_HEADER: Final = 1 << 20  # bytes to look for the end of a PLY header in
_STL: Final = struct.Struct("<80xI")
_STL_FACE: Final = 50
_GLB: Final = struct.Struct("<4sIII4s")
_WHITE: Final = np.ones(3)


def is_mesh(path: Path) -> bool:
    """Say whether a file holds a mesh, by its content where it can tell.

    A PLY file does if it has faces and no splats, a GLB or glTF file unless it has
    KHR_gaussian_splatting, an STL file if its length is as it says. OBJ files, and STL files of
    text, are known by their names. A file that cannot be opened holds none.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_HEADER)
    except OSError:
        return False
    suffix = path.suffix.lower()
    if head.startswith((b"ply\n", b"ply\r\n")):
        return _faces_in_ply(head) > 0 and not _splats_in_ply(head)
    if head.startswith(b"glTF") or suffix == ".gltf":
        return not _mentions(path, _SPLATS)
    return suffix in (".obj", ".stl") or _is_binary_stl(head, size)


def read_mesh(path: str | Path) -> tuple[Mesh, ...]:
    """Read the meshes that a GLB, glTF, OBJ, PLY or STL file shows: one a part with an own colour.

    Each is where its node says, in the axes of PLY files (x right, y down, z forward). Colours of
    vertices and faces, and textures of base colours, are shown as they are; what has neither is
    grey, with a headlight. All is opaque; lights, skins and animations are left out. Files that
    it names are read from its own folder alone.

    Raises:
        SceneUnreadable: The file holds no triangles that can be drawn.
        SceneInvalid: trimesh, which reads them, is not installed.
    """
    file = Path(path)
    trimesh = _trimesh()
    kind = _kind(file)
    try:
        _require_honest(file, kind)
        has_no_materials = kind == "obj" and not _has_materials(file)
        scene = _opened(trimesh, file, kind, has_no_materials)
        if kind in ("glb", "gltf"):
            _require_textures(json.loads(_json_of(file)), scene)
        meshes = tuple(_meshes(scene, file, kind in ("glb", "gltf"), has_no_materials))
    except SceneUnreadable:
        raise
    except GsgenError as error:
        message = f"{error.where}: {error.message}" if error.where else error.message
        raise SceneUnreadable(message, where=str(file), hint=error.hint) from error
    except Exception as error:  # whatever a reader of a hostile file stumbles over
        raise SceneUnreadable(
            f"is no readable {kind.upper()}: {type(error).__name__}: {_short(error)}",
            where=str(file),
            hint="Copy or export the file again.",
        ) from error
    if not any(len(mesh.data) for mesh in meshes):
        raise SceneUnreadable("has no triangles", where=str(file))
    return meshes


def _is_binary_stl(head: bytes, size: int | None = None) -> bool:
    """Say whether a file is as long as the count of triangles in its header says."""
    if len(head) < _STL.size:
        return False
    count = int(_STL.unpack_from(head)[0])
    return count > 0 and _STL.size + _STL_FACE * count == (size or len(head))


def _short(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 120 else text[:119] + "…"


def _trimesh() -> ModuleType:
    try:
        import trimesh
    except ImportError as error:
        raise SceneInvalid(
            "meshes need trimesh, which is not installed",
            hint="pip install 'gsgen[runtime]'",
        ) from error
    return trimesh


def _kind(path: Path) -> str:
    """Return the format of a file, by its first bytes or else its name."""
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise SceneUnreadable(f"cannot be opened: {error}", where=str(path)) from error
    marks = {b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply"}
    kind = marks.get(head, path.suffix.lower().removeprefix("."))
    if f".{kind}" not in SUFFIXES or (kind in ("glb", "ply") and head not in marks):
        raise SceneUnreadable(
            f"begins with {head.hex(' ') or 'nothing'}, which is no mesh",
            where=str(path),
            hint="Known: GLB, glTF, OBJ, PLY and STL.",
        )
    return kind


def _opened(trimesh: ModuleType, path: Path, kind: str, has_no_materials: bool) -> Any:
    """Return trimesh's scene; nothing is merged, and nothing comes from other folders."""
    options: dict[str, Any] = {"process": False}
    if kind == "obj":
        options |= {"skip_materials": has_no_materials, "maintain_order": True}
    content = path.read_bytes()
    if kind == "obj" or (kind == "stl" and not _is_binary_stl(content)):
        # Names in other encodings are none of our business.
        content = content.decode("utf-8", "replace").encode()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of a picture that would take too much memory
        return trimesh.load_scene(
            BytesIO(content),
            file_type=kind,
            resolver=trimesh.resolvers.FilePathResolver(str(path)),
            **options,
        )


def _meshes(scene: Any, path: Path, gltf: bool, has_no_materials: bool) -> Iterator[Mesh]:
    """Yield a mesh for each node; what several nodes show is held once."""
    by_geometry: dict[str, tuple[MeshData, bool]] = {}
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not hasattr(geometry, "faces") or not len(geometry.faces):
            continue  # points and lines
        if name not in by_geometry:
            by_geometry[name] = _data(geometry, gltf, has_no_materials)
        data, colored = by_geometry[name]
        transform = (_FROM_GLTF if gltf else np.eye(4)) @ np.asarray(matrix, np.float64)
        try:
            yield Mesh(data, transform, "unlit" if colored else "headlight")
        except SceneInvalid as error:
            message = f"node {node!r}: {error.where} {error.message}"
            raise SceneUnreadable(message, where=str(path), hint=error.hint) from error


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What the surface of a part looks like, with colours still in the space of the file."""

    colors: Float[np.ndarray, "v 3"] | None
    factor: Float[np.ndarray, "3"]
    uv: Float[np.ndarray, "v 2"] | None
    texture: UInt8[np.ndarray, "h w 4"] | None


def _data(geometry: Any, gltf: bool, has_no_materials: bool) -> tuple[MeshData, bool]:
    """Return the triangles of one part, and whether they have colours of their own.

    Args:
        geometry: What trimesh read.
        gltf: Whether from glTF, whose factors and vertex colours are linear (2.0, 3.9.2).
        has_no_materials: Whether materials are those that trimesh gives to what has none.
    """
    vertices = np.asarray(geometry.vertices, np.float64)
    faces = np.asarray(geometry.faces)
    visual = geometry.visual
    if getattr(visual, "kind", None) == "face":  # each face gets corners of its own
        vertices = vertices[faces].reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        face_colors = np.asarray(visual.face_colors)[:, :3] / 255.0
        look = _Look(np.repeat(face_colors, 3, axis=0), _WHITE, None, None)
    else:
        look = _look(geometry, has_no_materials)
    colored = (
        look.colors is not None or look.texture is not None or look.factor is not _WHITE
    )
    space: Literal["srgb", "linear"] = "srgb"
    colors = look.colors
    if colored:
        vertex_colors = (
            np.broadcast_to(_WHITE, vertices.shape) if colors is None else colors
        )
        colors = vertex_colors * look.factor
        if gltf and look.texture is None:
            space = "linear"
        elif gltf:
            colors = srgb_of_linear(np.clip(colors, 0, 1))
    data = MeshData(
        vertices, faces, colors, uv=look.uv, texture=look.texture, color_space=space
    )
    return data, colored


def _look(geometry: Any, has_no_materials: bool) -> _Look:
    visual = geometry.visual
    attributes = geometry.vertex_attributes
    colors = None
    if getattr(visual, "kind", None) == "vertex":
        colors = np.asarray(visual.vertex_colors)[:, :3] / 255.0
    elif "color" in attributes:
        vertex_colors = np.asarray(attributes["color"], np.float64)[:, :3]
        colors = (
            vertex_colors / 255.0
            if attributes["color"].dtype.kind in "iu"
            else vertex_colors
        )
    material = getattr(visual, "material", None)
    if material is None or has_no_materials:
        return _Look(colors, _WHITE, None, None)
    factor = getattr(material, "baseColorFactor", None)
    if factor is None:
        factor = getattr(material, "diffuse", None)
    tint = _WHITE if factor is None else np.asarray(factor)[:3] / 255.0
    image = getattr(material, "baseColorTexture", None)
    image = getattr(material, "image", None) if image is None else image
    uv = getattr(visual, "uv", None)
    if image is None or uv is None:
        return _Look(colors, tint, None, None)
    texture = np.asarray(image.convert("RGBA"))
    return _Look(colors, tint, np.asarray(uv, np.float64), texture)


def _has_materials(path: Path) -> bool:
    """Say whether an OBJ file names materials that are there; note where they are not."""
    with path.open("rb") as file:
        libraries = [line.split(None, 1) for line in file if line.startswith(b"mtllib")]
    names = [
        words[1].strip().decode("utf-8", "replace") for words in libraries if len(words) > 1
    ]
    absent = [name for name in names if not (path.parent / name).is_file()]
    if absent:
        note = f"{path}: {', '.join(absent)} is not beside it: drawn without its materials"
        warnings.warn(note, UserWarning, stacklevel=2)
    return bool(names) and not absent


def _mentions(path: Path, word: bytes) -> bool:
    """Say whether a word is in the JSON of a GLB or a glTF file."""
    return word in _json_of(path)


def _json_of(path: Path) -> bytes:
    with path.open("rb") as file:
        head = file.read(_GLB.size)
        if not head.startswith(b"glTF"):
            return head + file.read()
        if len(head) < _GLB.size:
            return b""
        return file.read(_GLB.unpack(head)[3])


def _lines_of_ply(head: bytes) -> list[list[bytes]]:
    return [line.split() for line in head.partition(b"end_header")[0].splitlines()]


def _counts_of_ply(head: bytes) -> dict[bytes, int]:
    return {
        words[1]: int(words[2])
        for words in _lines_of_ply(head)
        if len(words) == 3 and words[0] == b"element" and words[2].isdigit()
    }


def _faces_in_ply(head: bytes) -> int:
    return _counts_of_ply(head).get(b"face", 0)


def _splats_in_ply(head: bytes) -> bool:
    names = {words[-1] for words in _lines_of_ply(head) if words[:1] == [b"property"]}
    return bool(names & {b"f_dc_0", b"scale_0", b"rot_0", b"packed_position"})


def _require_honest(path: Path, kind: str) -> None:
    """Refuse a file that says it has more than its bytes can hold, before room is made for it."""
    size = path.stat().st_size
    if kind == "ply":
        with path.open("rb") as file:
            counts = _counts_of_ply(file.read(_HEADER))
        for name, count in counts.items():
            _require_count(count, size, f"element {name.decode('ascii', 'replace')}")
    elif kind == "stl":
        with path.open("rb") as file:
            head = file.read(_STL.size)
        if len(head) == _STL.size and not head.lstrip().startswith(b"solid"):
            _require_count(
                _STL.unpack(head)[0], (size - _STL.size) // _STL_FACE, "triangles"
            )
    elif kind in ("glb", "gltf"):
        _require_honest_gltf(path, size)


def _require_honest_gltf(path: Path, size: int) -> None:
    """Look at what of glTF makes readers take memory or time without end."""
    document = json.loads(_json_of(path))
    if not isinstance(document, dict):
        raise SceneInvalid(
            f"is a {type(document).__name__}, wanted an object", where="JSON"
        )
    for name in document.get("extensionsRequired", []):
        if name in _PACKED:
            raise SceneInvalid(
                f"needs {name}, which is not read here",
                where="extensionsRequired",
                hint="Export it without compression.",
            )
    room = size + sum(_beside(path, buffer) for buffer in document.get("buffers", []))
    for index, accessor in enumerate(document.get("accessors", [])):
        _require_count(accessor["count"], room, f"accessors[{index}].count")
    children = [
        child for node in document.get("nodes", []) for child in node.get("children", [])
    ]
    if len(children) != len(set(children)):
        raise SceneInvalid("has a node with two parents", where="nodes")
    _require_no_ring(document.get("nodes", []))


def _require_textures(document: dict[str, Any], scene: Any) -> None:
    """Refuse a file of whose textures some were not read: trimesh says nothing of it."""
    materials = document.get("materials", [])
    declared = sum(
        "baseColorTexture" in materials[part["material"]].get("pbrMetallicRoughness", {})
        for mesh in document.get("meshes", [])
        for part in mesh["primitives"]
        if "material" in part and "TEXCOORD_0" in part["attributes"]
    )
    loaded_materials = [
        getattr(geometry.visual, "material", None) for geometry in scene.geometry.values()
    ]
    loaded = sum(
        getattr(material, "baseColorTexture", None) is not None
        for material in loaded_materials
    )
    if loaded < declared:
        raise SceneInvalid(
            f"of {declared} parts with a texture, {declared - loaded} have one that cannot be read",
            where="textures",
            hint="Pictures are PNG, JPEG or WebP, and in the file or in its folder.",
        )


def _beside(path: Path, buffer: dict[str, Any]) -> int:
    """Return the size of the file that a buffer names, if it is there."""
    name = buffer.get("uri", "data:")
    file = path.parent / name
    return file.stat().st_size if not name.startswith("data:") and file.is_file() else 0


def _require_no_ring(nodes: list[dict[str, Any]]) -> None:
    """Refuse nodes that are their own ancestors; each has one parent at most."""
    parent = {
        child: parent
        for parent, node in enumerate(nodes)
        for child in node.get("children", [])
    }
    for start in parent:
        steps, node_index = 0, start
        while node_index in parent:
            node_index, steps = parent[node_index], steps + 1
            if steps > len(nodes):
                raise SceneInvalid("is its own ancestor", where=f"nodes[{start}]")


def _require_count(count: object, most: int, where: str) -> None:
    if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= most:
        raise SceneInvalid(f"is {count!r}, more than the file holds", where=where)

"""Reads mesh files (GLB, glTF, OBJ, PLY and STL) with trimesh."""

__all__ = ["is_mesh", "read_mesh"]

import json
import re
import struct
import warnings
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Float, UInt8

from gsgen.contract.errors import GsgenError
from gsgen.contract.file_kinds.names import MESH_SUFFIXES
from gsgen.contract.file_kinds.recognition import kind_of_file
from gsgen.contract.spec.srgb import srgb_of_linear
from gsgen.formats.glb.container import COMPRESSION_EXTENSIONS
from gsgen.formats.glb.splats import READABLE_EXTENSIONS
from gsgen.formats.shared.notices import warn_unused
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.scene.mesh import Mesh, MeshData

if TYPE_CHECKING:
    import trimesh

# Kinds of text that an OBJ or STL file may look like.
_MESH_KINDS: Final = ("obj", "stl", "text", "numbers", "zeros")

# glTF is x left, y up, z forward; worlds here, and PLY files, are x right, y down.
_SCENE_FROM_GLTF: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
_SPLAT_EXTENSION: Final = b"KHR_gaussian_splatting"
_COMPRESSION_EXTENSIONS: Final = (*COMPRESSION_EXTENSIONS, "KHR_texture_basisu")
_MAX_HEADER_BYTES: Final = (
    1 << 20
)  # bytes of a PLY file that are searched for the end of its header
_STL_HEADER: Final = struct.Struct("<80xI")
_STL_FACE: Final = 50
_GLB_HEADER: Final = struct.Struct("<4sIII4s")
_WHITE_RGB: Final = np.ones(3)
# A face of an OBJ file with an index that counts back.
_NEGATIVE_INDEX: Final = re.compile(rb"^[ \t]*f[ \t][^\n]*-", re.MULTILINE)

_GltfObject: TypeAlias = dict[str, Any]


def is_mesh(path: Path) -> bool:
    """Return whether a file holds a mesh, recognised by its content where possible.

    A PLY file must have faces and no splats, a GLB or glTF file must not use
    KHR_gaussian_splatting, and the length of an STL file must agree with its header. OBJ files, and
    STL files of text, are recognised by name. A file that cannot be opened is not a mesh.
    """
    try:
        if not path.is_file():  # opening a pipe would wait for its writer
            return False
        size = path.stat().st_size
        with path.open("rb") as file:
            header = file.read(_MAX_HEADER_BYTES)
        kind = kind_of_file(path)
    except OSError:
        return False
    suffix = path.suffix.lower()
    if header.startswith((b"ply\n", b"ply\r\n")):
        return _ply_face_count(header) > 0 and not _is_splat_ply(header)
    if header.startswith(b"glTF") or (kind is not None and kind.name.startswith("gltf")):
        return _SPLAT_EXTENSION not in _gltf_json(path)
    # The first bytes of an STL file are free: they may look like another kind.
    if _is_binary_stl(header, size):
        return True
    has_mesh_kind = kind is None or kind.name in _MESH_KINDS
    return suffix in (".obj", ".stl", ".gltf") and has_mesh_kind


def read_mesh(path: str | Path) -> tuple[Mesh, ...]:
    """Read the meshes of a GLB, glTF, OBJ, PLY or STL file, one per node of its scene.

    Each mesh has the transform of its node, in the axes of PLY files (x right, y down, z forward).
    Vertex colours, face colours and base colour textures are drawn unlit; a mesh without any is
    grey, with a headlight. All meshes are opaque; lights, skins and animations are ignored. Other
    files that the file names are read from its own folder alone.

    Raises:
        SceneUnreadable: The file holds no triangles that can be drawn.
        SceneInvalid: trimesh, which reads them, is not installed.
    """
    file = Path(path)
    library = _trimesh()
    kind = _mesh_kind(file)
    try:
        _require_plausible_sizes(file, kind)
        has_no_materials = kind == "obj" and not _has_materials(file)
        scene = _load_mesh_scene(library, file, kind, has_no_materials=has_no_materials)
        is_gltf = kind in ("glb", "gltf")
        if is_gltf:
            _require_textures(json.loads(_gltf_json(file)), scene)
        meshes = tuple(_meshes(scene, file, is_gltf=is_gltf, has_no_materials=has_no_materials))
    except SceneUnreadable:
        raise
    except GsgenError as error:
        message = f"{error.where}: {error.message}" if error.where else error.message
        raise SceneUnreadable(message, where=str(file), hint=error.hint) from error
    except Exception as error:  # a malformed file can raise any error in trimesh
        raise SceneUnreadable(
            f"cannot be read as {kind.upper()}: {type(error).__name__}: {_shorten_error(error)}",
            where=str(file),
            hint="Copy or export the file again.",
        ) from error
    if not any(len(mesh.data) for mesh in meshes):
        raise SceneUnreadable(
            "the mesh file has no triangles", where=str(file), hint="Give a file with faces."
        )
    return meshes


def _is_binary_stl(header: bytes, size: int | None = None) -> bool:
    """Return whether the length of an STL file agrees with the triangle count in its header."""
    if len(header) < _STL_HEADER.size:
        return False
    count = int(_STL_HEADER.unpack_from(header)[0])
    return count > 0 and _STL_HEADER.size + _STL_FACE * count == (size or len(header))


def _shorten_error(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 120 else text[:119] + "…"


def _trimesh() -> ModuleType:
    try:
        import trimesh
    except ImportError as error:
        raise SceneInvalid(
            "meshes need trimesh, which is not installed", hint="pip install 'gsgen[runtime]'"
        ) from error
    return trimesh


def _mesh_kind(path: Path) -> str:
    """Return the format of a mesh file, from its first bytes or else its name."""
    try:
        with path.open("rb") as file:
            header = file.read(4)
    except OSError as error:
        raise SceneUnreadable(f"cannot be opened: {error}", where=str(path)) from error
    kind_by_magic = {b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply"}
    kind = kind_by_magic.get(header, path.suffix.lower().removeprefix("."))
    if f".{kind}" not in MESH_SUFFIXES or (kind in ("glb", "ply") and header not in kind_by_magic):
        raise SceneUnreadable(
            f"begins with the bytes {header.hex(' ') or '(none)'}, expected a mesh",
            where=str(path),
            hint="Known: GLB, glTF, OBJ, PLY and STL.",
        )
    return kind


def _load_mesh_scene(
    library: ModuleType, path: Path, kind: str, *, has_no_materials: bool
) -> "trimesh.Scene":
    """Load a mesh file with trimesh, without merging vertices, from its own folder only."""
    options = {"process": False}
    if kind == "obj":
        options |= {"skip_materials": has_no_materials, "maintain_order": True}
    content = path.read_bytes()
    if kind == "obj" or (kind == "stl" and not _is_binary_stl(content)):
        # Names in other encodings must not raise errors.
        content = content.decode("utf-8", "replace").encode()
    if kind == "obj":
        content = _with_absolute_indices(content)
    with warnings.catch_warnings():
        # Other warnings of the libraries are no verdict on the file.
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", ".*decompression bomb")  # pictures of too much memory
        scene: trimesh.Scene = library.load_scene(
            BytesIO(content), file_type=kind, resolver=_resource_resolver(library, path), **options
        )
    return scene


def _with_absolute_indices(content: bytes) -> bytes:
    """Replace the negative indices of an OBJ file, which count back from the line of the face.

    trimesh reads them as counted from the end of the file, or not at all.
    """
    if not _NEGATIVE_INDEX.search(content):
        return content
    counts = {b"v": 0, b"vt": 0, b"vn": 0}
    lines = content.splitlines()
    for number, line in enumerate(lines):
        words = line.split()
        if words and words[0] in counts:
            counts[words[0]] += 1
        elif words and words[0] == b"f" and b"-" in line:
            corners = (_absolute_corner(word, list(counts.values())) for word in words[1:])
            lines[number] = b" ".join([b"f", *corners])
    return b"\n".join(lines)


def _absolute_corner(corner: bytes, counts: list[int]) -> bytes:
    """Return a corner of a face, position/texture/normal, with indices from 1."""
    parts = corner.split(b"/")
    for number, (part, count) in enumerate(zip(parts, counts, strict=False)):
        if part.startswith(b"-"):
            parts[number] = b"%d" % (count + 1 + int(part))
    return b"/".join(parts)


def _resource_resolver(library: ModuleType, path: Path) -> Any:
    """Return what opens the files that a mesh file names: regular files in its folder."""

    class RegularFiles(library.resolvers.FilePathResolver):  # type: ignore[name-defined, misc]
        def absolute(self, name: str) -> Path:
            file = Path(super().absolute(name))
            if file.exists() and not file.is_file():
                message = "is a folder, device or pipe, expected a regular file"
                raise SceneInvalid(message, where=name)
            return file

    return RegularFiles(str(path))


def _meshes(
    scene: "trimesh.Scene", path: Path, *, is_gltf: bool, has_no_materials: bool
) -> Iterator[Mesh]:
    """Yield a mesh for each node of a scene; nodes of one geometry share the data."""
    mesh_by_geometry: dict[object, tuple[MeshData, bool]] = {}
    matrices = _world_matrices(scene)
    for node in scene.graph.nodes_geometry:
        name = scene.graph.transforms.node_data[node]["geometry"]
        geometry = scene.geometry[name]
        if not hasattr(geometry, "faces") or not len(geometry.faces):
            continue  # points and lines
        if name not in mesh_by_geometry:
            if not _has_color_by_vertex(geometry) and "color" in geometry.vertex_attributes:
                warn_unused(path, ["vertex colours, beside texture coordinates by face"])
            mesh_by_geometry[name] = _mesh_data(
                geometry, is_gltf=is_gltf, has_no_materials=has_no_materials
            )
        data, is_colored = mesh_by_geometry[name]
        transform = (_SCENE_FROM_GLTF if is_gltf else np.eye(4)) @ matrices[node]
        try:
            yield Mesh(data, transform, "unlit" if is_colored else "headlight")
        except SceneInvalid as error:
            message = f"node {node!r}: {error.where} {error.message}"
            raise SceneUnreadable(message, where=str(path), hint=error.hint) from error


def _world_matrices(scene: "trimesh.Scene") -> dict[Hashable, Float[np.ndarray, "4 4"]]:
    """Return node → matrix to the world; trimesh's own takes the cube of the depth for each node."""
    children: dict[Hashable, list[tuple[Hashable, Float[np.ndarray, "4 4"]]]] = {}
    edges = scene.graph.to_edgelist()  # type: ignore[no-untyped-call]
    for parent, child, attributes in edges:
        local_matrix = np.array(attributes.get("matrix", np.eye(4)), np.float64)
        children.setdefault(parent, []).append((child, local_matrix))
    matrices: dict[Hashable, Float[np.ndarray, "4 4"]] = {scene.graph.base_frame: np.eye(4)}
    pending: list[Hashable] = [scene.graph.base_frame]
    while pending:
        parent = pending.pop()
        for child, local_matrix in children.get(parent, ()):
            matrices[child] = matrices[parent] @ local_matrix
            pending.append(child)
    return matrices


@final
@dataclass(frozen=True, slots=True, eq=False)
class _SurfaceMaterial:
    """The colours and the texture of a mesh, in the colour space of the file."""

    colors: Float[np.ndarray, "v 3"] | None
    color_factor: Float[np.ndarray, "3"]
    uv: Float[np.ndarray, "v 2"] | None = None
    texture: UInt8[np.ndarray, "h w 4"] | None = None


def _mesh_data(
    geometry: "trimesh.Trimesh", *, is_gltf: bool, has_no_materials: bool
) -> tuple[MeshData, bool]:
    """Convert a mesh of trimesh, and return whether it has colours of its own.

    In glTF, factors and vertex colours are linear (2.0, 3.9.2); without materials in the file,
    trimesh adds its own.
    """
    vertices = np.asarray(geometry.vertices, np.float64)
    faces = np.asarray(geometry.faces)
    visual: Any = geometry.visual  # attributes depend on the kind
    if getattr(visual, "kind", None) == "face":  # each face gets corners of its own
        vertices = vertices[faces].reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        face_colors = np.asarray(visual.face_colors)[:, :3] / 255.0
        surface = _SurfaceMaterial(np.repeat(face_colors, 3, axis=0), _WHITE_RGB)
    else:
        surface = _surface_material(geometry, has_no_materials=has_no_materials)
    is_colored = (
        surface.colors is not None
        or surface.texture is not None
        or surface.color_factor is not _WHITE_RGB
    )
    space: Literal["srgb", "linear"] = "srgb"
    colors = surface.colors
    if is_colored:
        vertex_colors = np.broadcast_to(_WHITE_RGB, vertices.shape) if colors is None else colors
        colors = vertex_colors * surface.color_factor
        if is_gltf and surface.texture is None:
            space = "linear"
        elif is_gltf:
            colors = srgb_of_linear(np.clip(colors, 0, 1))
    data = MeshData(
        vertices, faces, colors, uv=surface.uv, texture=surface.texture, color_space=space
    )
    return data, is_colored


def _has_color_by_vertex(geometry: "trimesh.Trimesh") -> bool:
    """Return whether a mesh has colours for its vertices, not for those before trimesh split them."""
    colors = np.asarray(geometry.vertex_attributes.get("color", ()))
    return len(colors) == len(geometry.vertices)


def _surface_material(geometry: "trimesh.Trimesh", *, has_no_materials: bool) -> _SurfaceMaterial:
    visual: Any = geometry.visual  # attributes depend on the kind
    attributes = geometry.vertex_attributes
    colors = None
    if getattr(visual, "kind", None) == "vertex":
        colors = np.asarray(visual.vertex_colors)[:, :3] / 255.0
    elif _has_color_by_vertex(geometry):
        vertex_colors = np.asarray(attributes["color"])[:, :3]
        colors = vertex_colors / (255.0 if vertex_colors.dtype.kind in "iu" else 1.0)
    material = getattr(visual, "material", None)
    if material is None or has_no_materials:
        return _SurfaceMaterial(colors, _WHITE_RGB)
    rgba = getattr(material, "baseColorFactor", None)
    if rgba is None:
        rgba = getattr(material, "diffuse", None)
    color_factor = _WHITE_RGB if rgba is None else np.asarray(rgba)[:3] / 255.0
    image = getattr(material, "baseColorTexture", None)
    image = getattr(material, "image", None) if image is None else image
    uv = getattr(visual, "uv", None)
    if image is None or uv is None:
        return _SurfaceMaterial(colors, color_factor)
    texture = np.asarray(image.convert("RGBA"))
    return _SurfaceMaterial(colors, color_factor, np.asarray(uv, np.float64), texture)


def _has_materials(path: Path) -> bool:
    """Return whether an OBJ file has all the material files it names; warn of missing ones."""
    with path.open("rb") as file:
        libraries = [line.split(None, 1) for line in file if line.startswith(b"mtllib")]
    names = [words[1].strip().decode("utf-8", "replace") for words in libraries if len(words) > 1]
    missing_files = [name for name in names if not (path.parent / name).is_file()]
    if missing_files:
        note = f"{path}: {', '.join(missing_files)} is missing in its folder; the mesh is drawn without materials"
        warnings.warn(note, UserWarning, stacklevel=2)
    return bool(names) and not missing_files


def _gltf_json(path: Path) -> bytes:
    """Return the JSON text of a GLB or a glTF file."""
    with path.open("rb") as file:
        header = file.read(_GLB_HEADER.size)
        if not header.startswith(b"glTF"):
            return header + file.read()
        if len(header) < _GLB_HEADER.size:
            return b""
        return file.read(_GLB_HEADER.unpack(header)[3])


def _ply_header_lines(header: bytes) -> list[list[bytes]]:
    return [line.split() for line in header.partition(b"end_header")[0].splitlines()]


def _ply_element_counts(header: bytes) -> dict[bytes, int]:
    return {
        words[1]: int(words[2])
        for words in _ply_header_lines(header)
        if len(words) == 3 and words[0] == b"element" and words[2].isdigit()
    }


def _ply_face_count(header: bytes) -> int:
    return _ply_element_counts(header).get(b"face", 0)


def _is_splat_ply(header: bytes) -> bool:
    names = {words[-1] for words in _ply_header_lines(header) if words[:1] == [b"property"]}
    return bool(names & {b"f_dc_0", b"scale_0", b"rot_0", b"packed_position"})


def _require_plausible_sizes(path: Path, kind: str) -> None:
    """Raise if the counts in a mesh file exceed its bytes, before memory is allocated."""
    size = path.stat().st_size
    if kind == "ply":
        with path.open("rb") as file:
            counts = _ply_element_counts(file.read(_MAX_HEADER_BYTES))
        for name, count in counts.items():
            _require_count(count, size, f"element {name.decode('ascii', 'replace')}")
    elif kind == "stl":
        with path.open("rb") as file:
            header = file.read(_STL_HEADER.size)
        if len(header) == _STL_HEADER.size and not header.lstrip().startswith(b"solid"):
            _require_count(
                _STL_HEADER.unpack(header)[0], (size - _STL_HEADER.size) // _STL_FACE, "triangles"
            )
    elif kind in ("glb", "gltf"):
        _require_plausible_gltf(path, size)


def _require_plausible_gltf(path: Path, size: int) -> None:
    """Raise if the counts or nodes of a glTF file would take unbounded memory or time."""
    document = json.loads(_gltf_json(path))
    if not isinstance(document, dict):
        message = f"the glTF document is a {type(document).__name__}, expected an object"
        raise SceneInvalid(message, where="JSON")
    for name in document.get("extensionsRequired", []):
        if not any(fnmatchcase(str(name), pattern) for pattern in READABLE_EXTENSIONS):
            is_packed = name in _COMPRESSION_EXTENSIONS
            raise SceneInvalid(
                f"needs {name}, which is not supported",
                where="extensionsRequired",
                hint=f"Export the file without {'compression' if is_packed else 'it'}.",
            )
    room = size + sum(_buffer_size(path, buffer) for buffer in document.get("buffers", []))
    for index, accessor in enumerate(document.get("accessors", [])):
        _require_count(accessor["count"], room, f"accessors[{index}].count")
    children = [child for node in document.get("nodes", []) for child in node.get("children", [])]
    if len(children) != len(set(children)):
        raise SceneInvalid("has a node with two parents, expected a tree", where="nodes")
    _require_no_cycle(document.get("nodes", []))


def _require_textures(document: _GltfObject, scene: "trimesh.Scene") -> None:
    """Raise if textures of a glTF file were not read: trimesh skips them silently."""
    materials = document.get("materials", [])
    declared_count = sum(
        "baseColorTexture" in materials[part["material"]].get("pbrMetallicRoughness", {})
        for mesh in document.get("meshes", [])
        for part in mesh["primitives"]
        if "material" in part and "TEXCOORD_0" in part["attributes"]
    )
    loaded_materials = [
        getattr(geometry.visual, "material", None) for geometry in scene.geometry.values()
    ]
    loaded_count = sum(
        getattr(material, "baseColorTexture", None) is not None for material in loaded_materials
    )
    if loaded_count < declared_count:
        raise SceneInvalid(
            f"cannot be read for {declared_count - loaded_count} of {declared_count} parts",
            where="textures",
            hint="Textures must be PNG, JPEG or WebP, inside the file or in its folder.",
        )


def _buffer_size(path: Path, buffer: _GltfObject) -> int:
    """Return the size of the file that a glTF buffer names, or 0 if the file is missing."""
    name = buffer.get("uri", "data:")
    file = path.parent / name
    return file.stat().st_size if not name.startswith("data:") and file.is_file() else 0


def _require_no_cycle(nodes: list[_GltfObject]) -> None:
    """Raise if a glTF node is its own ancestor; each node has at most one parent."""
    children = [node.get("children", []) for node in nodes]
    unreached_nodes = set(range(len(nodes)))
    pending = list(unreached_nodes.difference(*children))  # the roots
    while pending:
        node_index = pending.pop()
        unreached_nodes.discard(node_index)
        pending += children[node_index]
    if unreached_nodes:
        raise SceneInvalid(
            "the node is its own ancestor, expected a tree", where=f"nodes[{min(unreached_nodes)}]"
        )


def _require_count(count: object, limit: int, where: str) -> None:
    if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= limit:
        raise SceneInvalid(
            f"is {count!r}, expected at most {limit} by the size of the file", where=where
        )

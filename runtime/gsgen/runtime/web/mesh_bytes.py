"""Mesh files as web pages get them: with the files of their folder that they name in them."""

__all__ = ["mesh_bytes"]

import base64
import json
import mimetypes
import re
from pathlib import Path
from typing import Final
from urllib.parse import unquote

from gsgen.runtime.errors import SceneUnreadable
from gsgen.runtime.sources.mesh_files import read_mesh

_LIBRARY: Final = re.compile(rb"^([ \t]*mtllib[ \t]+)([^\r\n]+?)([ \t]*)$", re.MULTILINE)
_MAP: Final = re.compile(rb"^([ \t]*map_Kd[ \t]+)([^\r\n]+?)([ \t]*)$", re.MULTILINE)


def mesh_bytes(path: Path) -> bytes:
    """Return the bytes of a mesh file for a web page, with its materials and textures.

    Raises:
        SceneUnreadable: The file cannot be read, or holds no triangles.
    """
    suffix = path.suffix.lower()
    if suffix != ".fbx":  # which pages alone read
        read_mesh(path)
    try:
        content = path.read_bytes()
        if suffix == ".obj":
            return _LIBRARY.sub(lambda match: _with_file(match, path.parent), content)
        if not content.startswith(b"glTF") and suffix == ".gltf":
            return _embedded_gltf(content, path.parent)
    except OSError as error:
        raise SceneUnreadable(f"cannot be read: {error}", where=str(path)) from error
    return content


def _embedded_gltf(content: bytes, folder: Path) -> bytes:
    document = json.loads(content)
    for part in [*document.get("buffers", []), *document.get("images", [])]:
        if "uri" in part:
            part["uri"] = _data_url(unquote(part["uri"]), folder) or part["uri"]
    return json.dumps(document).encode()


def _with_file(match: re.Match[bytes], folder: Path) -> bytes:
    """Return a line of an OBJ or MTL file whose file is in it; as it is where that is missing."""
    address = _data_url(match[2].decode("utf-8", "replace"), folder)
    return match[1] + address.encode() + match[3] if address else match[0]


def _data_url(name: str, folder: Path) -> str:
    """Return a file of a folder as a data URL; empty if the folder has no such file."""
    file = (folder / name).resolve()
    if not file.is_relative_to(folder.resolve()) or not file.is_file():
        return ""
    content = file.read_bytes()
    if file.suffix.lower() == ".mtl":
        content = _MAP.sub(lambda match: _with_file(match, folder), content)
    kind = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"

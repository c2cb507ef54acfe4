"""Names by which files are told apart where their content is not looked at."""

__all__ = ["MESH_SUFFIXES", "META_FILE", "SPLAT_FORMATS", "SPLAT_SUFFIXES", "STREAMED_META"]

from typing import Final

SPLAT_SUFFIXES: Final = (".ply", ".spz", ".splat", ".ksplat", ".sog")
"""Suffixes of files of splats; others, such as .glb and .npz, may as well hold other things."""

SPLAT_FORMATS: Final = (
    "PLY, compressed PLY, SPZ, GLB, SOG, KSPLAT, SPLAT, PyTorch checkpoint or NPZ"
)
"""The titles of all formats of files of splats, for help that imports no reader."""

MESH_SUFFIXES: Final = (".glb", ".gltf", ".obj", ".ply", ".stl")
"""Suffixes of files that may hold meshes."""

META_FILE: Final = "meta.json"
"""The file of an unpacked SOG that describes its images."""

STREAMED_META: Final = "lod-meta.json"
"""The file that lists the SOG files of several levels of detail."""

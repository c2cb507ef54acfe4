"""Kinds of folders, by the files that programs write into them."""

__all__ = ["kind_of_folder"]

import os
from pathlib import Path
from typing import Final

from gsgen.contract.file_kinds.kind import CAMERAS, SPLATS, TILESET, FileKind
from gsgen.contract.file_kinds.names import META_FILE, SPLAT_SUFFIXES, STREAMED_META

# Patterns of paths in a folder → name, title, hint; the first that matches a file counts.
_FOLDER_KINDS: Final[tuple[tuple[tuple[str, ...], str, str, str], ...]] = (
    (
        ("point_cloud/iteration_*/point_cloud.ply", "iteration_*/point_cloud.ply", "cfg_args"),
        "3dgs-training",
        "the folder of a 3DGS training",
        SPLATS,
    ),
    (
        ("nerfstudio_models/step-*.ckpt", "step-*.ckpt"),
        "nerfstudio-training",
        "the folder of a nerfstudio training",
        SPLATS,
    ),
    (
        ("ckpts/ckpt_*.pt", "ply/point_cloud_*.ply"),
        "gsplat-training",
        "the folder of a gsplat training",
        SPLATS,
    ),
    (("tileset.json",), "tileset-folder", "the folder of a tileset", TILESET),
    ((STREAMED_META, META_FILE), "sog-folder", "the folder of a SOG", SPLATS),
    (
        tuple(f"*{suffix}" for suffix in SPLAT_SUFFIXES),
        "splat-folder",
        "a folder of splat files",
        SPLATS,
    ),
    (
        ("sparse/0/cameras.*", "sparse/cameras.*", "cameras.bin", "cameras.txt"),
        "colmap-folder",
        "a data set of COLMAP",
        CAMERAS,
    ),
    (("transforms*.json",), "cameras-folder", "a data set of pictures with cameras", CAMERAS),
)


def kind_of_folder(path: str | os.PathLike[str]) -> FileKind | None:
    """Return the kind of a folder that a known program wrote; None for any other."""
    folder = Path(path)
    for patterns, name, title, hint in _FOLDER_KINDS:
        if any(entry.is_file() for pattern in patterns for entry in folder.glob(pattern)):
            return FileKind(name=name, title=title, hint=hint)
    return None

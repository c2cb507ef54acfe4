"""The data class of a kind of file, and the advice that several kinds share."""

__all__ = [
    "CAMERAS",
    "DOWNLOAD_AGAIN_HINT",
    "EXPORT_SPLATS_HINT",
    "MESH_RENDER_HINT",
    "MODEL",
    "SPLATS",
    "TILESET",
    "UNPACK",
    "FileKind",
]

from dataclasses import dataclass
from typing import Final, final

SPLATS: Final = (
    "`gsgen render` draws it, `gsgen convert` writes other formats, and `gsgen export static` "
    "makes a model of it."
)
MESH_RENDER_HINT: Final = "A mesh: `gsgen render` draws it."
MODEL: Final = (
    "With the suffix .onnx, `gsgen render` draws it, `gsgen bake` writes its splats, and "
    "`gsgen validate` checks it."
)
TILESET: Final = "`gsgen render`, `gsgen validate` and `gsgen tiles info` take its tileset.json."
CAMERAS: Final = "Cameras: give it to `gsgen render --camera`, beside the scene."
EXPORT_SPLATS_HINT: Final = (
    "Export splats as PLY, or a mesh as GLB, with the program that wrote it."
)
DOWNLOAD_AGAIN_HINT: Final = "Copy or download the file again."
UNPACK: Final = "Unpack it, and name one file of it."


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FileKind:
    """A kind of file, as an error message describes it.

    Attributes:
        name: A short name, such as ``git-lfs``.
        title: What the file is, with an article: "a git LFS pointer".
        hint: What to do with it; may be empty.
    """

    name: str
    title: str
    hint: str = ""

    @property
    def holds_splats(self) -> bool:
        """Whether gsgen reads splats from such a file."""
        return self.hint == SPLATS

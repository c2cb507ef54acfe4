"""Opens splat files, mesh files and ONNX generators as sources for the renderer."""

__all__ = ["is_model", "open_source"]

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.contract.file_kinds.recognition import kind_of_file
from gsgen.formats.tileset_paths import names_tileset
from gsgen.runtime.errors import SceneUnreadable
from gsgen.runtime.sources.mesh_files import is_mesh
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.source import GeneratorSource, Source, StillFrameSource
from gsgen.runtime.sources.stream_settings import StreamOpener

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels


def open_source(
    path: Path,
    provider: str = "cpu",
    sizes: Mapping[str, int] | None = None,
    stream: StreamOpener | None = None,
    confined: "ConfinedModels | None" = None,
) -> Source:
    """Open a file of Gaussians or triangles, a tileset or an ONNX generator for the renderer.

    Args:
        path: The file.
        provider: ONNX Runtime's execution provider for a generator, and for those of neural tiles.
        sizes: Symbol → size of an open dimension of a generator.
        stream: Opens tilesets, such as ``gsgen.tiles.open_stream``.
        confined: Runs a generator in a child process with limits; None runs it in this process.

    Raises:
        SceneUnreadable: The file holds no Gaussians or triangles that can be read.
        ModelUnreadable: The file is not an ONNX model.
        SceneInvalid: The model is not a generator.
        SizeUnknown: A dimension has no size.
    """
    if is_model(path):
        return GeneratorSource(path, provider, sizes, confined)
    if names_tileset(path):
        if stream is None:
            raise SceneUnreadable(
                "is a tileset, which this function was given nothing to open with",
                where=str(path),
                hint="Pass stream=gsgen.tiles.open_stream.",
            )
        return stream(path, provider)
    return MeshSource(path) if is_mesh(path) else StillFrameSource(path)


def is_model(path: Path) -> bool:
    """Return whether a file is an ONNX model: by its content, or by its name if that is unknown."""
    is_named_so = path.suffix.lower() == ".onnx"
    try:
        kind = kind_of_file(path)
    except OSError:  # opening it reports the cause
        return is_named_so
    return is_named_so if kind is None else kind.name == "onnx"

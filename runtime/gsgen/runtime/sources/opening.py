"""Opens splat files, mesh files and ONNX generators as sources for the renderer."""

__all__ = ["open_source"]

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from gsgen.formats.shared.origins import Origin
from gsgen.formats.tileset_paths import names_stream, names_tileset
from gsgen.runtime.errors import SceneUnreadable
from gsgen.runtime.sources.mesh_files import is_mesh
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.sequence_source import SequenceSource, sequence_files
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
    origin: Origin | None = None,
) -> Source:
    """Open a file of Gaussians or triangles, a tileset or an ONNX generator for the renderer.

    Args:
        path: The file, or its address.
        provider: ONNX Runtime's execution provider for a generator, and for those of neural tiles.
        sizes: Symbol → size of an open dimension of a generator.
        stream: Opens tilesets, such as ``gsgen.tiles.open_stream``.
        confined: Runs a generator in a child process with limits; None runs it in this process.
        origin: The point of a splat file that float32 positions are relative to; None for 0, or
            for a point that float32 needs to keep the digits of coordinates such as those of maps.

    Raises:
        SceneUnreadable: The file holds no Gaussians or triangles that can be read.
        ModelUnreadable: The file is not an ONNX model.
        SceneInvalid: The model is not a generator.
        SizeUnknown: A dimension has no size.
        InputUnreadable: The file at an address cannot be had.
    """
    if not path.exists() or path.suffix.lower() == ".zip":
        path = _on_disk(path, is_streamed=stream is not None)
    if files := sequence_files(path):
        return (
            SequenceSource(path, files, origin)
            if len(files) > 1
            else StillFrameSource(files[0], origin)
        )
    if path.suffix.lower() == ".onnx":
        return GeneratorSource(path, provider, sizes, confined)
    if stream is not None and names_stream(path):
        return stream(path, provider)
    if names_tileset(path):
        raise SceneUnreadable(
            "is a tileset, which this function was given nothing to open with",
            where=str(path),
            hint="Pass stream=gsgen.tiles.open_stream.",
        )
    return MeshSource(path) if is_mesh(path) else StillFrameSource(path, origin)


def _on_disk(path: Path, *, is_streamed: bool) -> Path:
    """Return the file of an address or archive; what is streamed stays an address."""
    from gsgen.contract.model.fetched_inputs import local_file

    stays = names_stream(path) if is_streamed else names_tileset(path)
    return path if stays else local_file(path)

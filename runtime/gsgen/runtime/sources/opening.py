"""Opens splat files, mesh files and ONNX generators as sources for the renderer."""

__all__ = ["open_source"]

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from gsgen.contract._entry_points import registered_entry_points
from gsgen.runtime.sources.mesh_files import is_mesh
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.source import GeneratorSource, Source, StillSource
from gsgen.runtime.sources.stream_settings import StreamOpener, StreamSettings


def open_source(
    path: Path,
    provider: str = "cpu",
    sizes: Mapping[str, int] | None = None,
    streaming: StreamSettings | None = None,
) -> Source:
    """Open a file of Gaussians or triangles, a tileset or an ONNX generator for the renderer.

    Args:
        path: The file.
        provider: ONNX Runtime's execution provider for a generator, and for those of neural tiles.
        sizes: Symbol → size of an open dimension of a generator.
        streaming: How a tileset is streamed.

    Raises:
        SceneUnreadable: The file holds no Gaussians or triangles that can be read.
        ModelUnreadable: The file is not an ONNX model.
        SceneInvalid: The model is not a generator.
        SizeUnknown: A dimension has no size.
    """
    if path.suffix.lower() == ".onnx":
        return GeneratorSource(path, provider, sizes)
    for point in registered_entry_points("gsgen.sources"):
        opener: StreamOpener = point.load()
        if opener.recognises(path):
            settings = replace(streaming or StreamSettings(), provider=provider)
            return opener.open_stream(path, settings)
    return MeshSource(path) if is_mesh(path) else StillSource(path)

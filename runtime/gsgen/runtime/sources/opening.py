"""Opens splat files, mesh files and ONNX generators as sources."""

__all__ = ["open_source"]

from collections.abc import Mapping
from pathlib import Path

from gsgen.runtime.sources.mesh_files import is_mesh
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.source import GeneratorSource, Source, StillSource


def open_source(
    path: Path, provider: str = "cpu", sizes: Mapping[str, int] | None = None
) -> Source:
    """Open a file of Gaussians or triangles, or a generator, which has the suffix ``.onnx``.

    Args:
        path: The file.
        provider: ONNX Runtime's execution provider for a generator.
        sizes: Symbol → size of an open dimension of a generator.

    Raises:
        SceneUnreadable: The file holds no Gaussians or triangles that can be read.
        ModelUnreadable: The file is not an ONNX model.
        SceneInvalid: The model is not a generator.
        SizeUnknown: A dimension has no size.
    """
    if path.suffix.lower() == ".onnx":
        return GeneratorSource(path, provider, sizes)
    return MeshSource(path) if is_mesh(path) else StillSource(path)

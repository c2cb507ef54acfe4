"""Meshes as a source: a file of triangles that is drawn among Gaussians."""

__all__ = ["MeshSource"]

from collections.abc import Sequence
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.mesh_files import read_mesh
from gsgen.runtime.sources.source import Source, Values


@final
class MeshSource(Source):
    """A file of triangles; it has no Gaussians.

    Args:
        path: What ``read_mesh`` reads.
        meshes: What is drawn in place of what the file holds, where it was read before.
    """

    def __init__(self, path: Path, meshes: Sequence[Mesh] | None = None) -> None:
        self.name = str(path)
        self.meshes = tuple(read_mesh(path) if meshes is None else meshes)
        none = np.zeros((0, 10), np.float32)
        self.data = SplatData(none, np.zeros((0, 3), np.float32), "rgb")

    def start(self, camera: Camera | None, values: Values, frame: int = 0) -> None:
        """Do nothing: a file stays as it is."""

    def finish(self) -> None:
        """Do nothing: a file stays as it is."""

    def abandon(self) -> None:
        """Do nothing: a file stays as it is."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Raise: a file has no inputs."""
        raise KeyError(name)

    def extent(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Return the middle of the triangles and half the diagonal of the box around them."""
        corners = np.concatenate([_box(mesh) for mesh in self.meshes if len(mesh.data)])
        low, high = corners.min(axis=0), corners.max(axis=0)
        return (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0

    def close(self) -> None:
        """Do nothing: the file was closed when it was read."""


def _box(mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    """Return the vertices that faces use, in the world."""
    used = mesh.data.vertices[np.unique(mesh.data.faces)].astype(np.float64)
    return np.asarray(used @ mesh.transform[:3, :3].T + mesh.transform[:3, 3])

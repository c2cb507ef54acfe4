"""A scene source with meshes, which are drawn together with Gaussians."""

__all__ = ["MeshSource"]

from collections.abc import Sequence
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.scene.mesh import Mesh
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.mesh_files import read_mesh
from gsgen.runtime.sources.source import StaticSource


@final
class MeshSource(StaticSource):
    """The triangles of a mesh file, or of given meshes, as a scene source without Gaussians."""

    def __init__(self, path: Path, meshes: Sequence[Mesh] | None = None) -> None:
        self.name = str(path)
        self.meshes = tuple(read_mesh(path) if meshes is None else meshes)
        no_rows = np.zeros((0, 10), np.float32)
        self.data = SplatData(no_rows, np.zeros((0, 3), np.float32), "rgb")

    def extent(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Return the centre of the box around the triangles, and half its diagonal."""
        corners = np.concatenate([_vertices(mesh) for mesh in self.meshes if len(mesh.data)])
        low, high = corners.min(axis=0), corners.max(axis=0)
        return (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0


def _vertices(mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    """Return the vertices of a mesh, in world space, that at least one face uses."""
    used = mesh.data.vertices[np.unique(mesh.data.faces)].astype(np.float64)
    matrix = mesh.vertices_to_world
    return np.asarray(used @ matrix[:3, :3].T + matrix[:3, 3])

"""Converts scenes in memory to the sources of Gaussians that players and windows take."""

__all__ = ["SceneSource", "sources_of"]

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.scene_file import is_scene_file, open_scene
from gsgen.runtime.sources.source import Source, StaticSource
from gsgen.runtime.sources.stream_settings import StreamOpener

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels


@final
class SceneSource(StaticSource):
    """A splat set in memory as a source of Gaussians, which its owner may change."""

    def __init__(
        self, splat_set: SplatSet, color_space: Literal["srgb", "linear"] = "srgb"
    ) -> None:
        self._splat_set = splat_set
        self.name, self.data = "scene", splat_set.data
        self.antialias = splat_set.antialias or "classic"
        self.color_space, self.weighted = color_space, splat_set.weighted

    def splats(
        self, sh_degree: int | None, antialias: Literal["classic", "mip"] | None
    ) -> SplatSet:
        """Return the splat set with the given SH degree and antialiasing."""
        degree = self._splat_set.degree if sh_degree is None else sh_degree
        return replace(self._splat_set, degree=degree, antialias=antialias or self.antialias)

    def extent(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Return the world-space centre of a box around most Gaussians, and half the diagonal."""
        center, reach = super().extent()
        linear, offset = self._splat_set.transform[:3, :3], self._splat_set.transform[:3, 3]
        scale = float(np.cbrt(abs(np.linalg.det(linear))))
        return linear @ center + offset, reach * scale


def sources_of(
    scene: Scene | SplatData | str | Path | Sequence[str | Path],
    stream: StreamOpener | None = None,
    confined: "ConfinedModels | None" = None,
) -> list[Source]:
    """Return sources of Gaussians for a scene: an object in memory, or paths of files.

    ``stream`` opens tilesets, as ``gsgen.tiles.open_stream`` does; ``confined`` runs generators in
    a child process with limits.
    """
    if isinstance(scene, SplatData):
        scene = Scene([scene])
    if isinstance(scene, Scene):
        sources: list[Source] = [
            SceneSource(splat_set, scene.color_space) for splat_set in scene.sets
        ]
        if scene.meshes:
            sources.append(MeshSource(Path("meshes"), scene.meshes))
        return sources
    paths = [scene] if isinstance(scene, str | Path) else scene
    opened_sources: list[Source] = []
    try:
        for path in map(Path, paths):
            if is_scene_file(path):
                opened_sources += open_scene(path, stream=stream, confined=confined)
            else:
                opened_sources.append(open_source(path, stream=stream, confined=confined))
    except BaseException:
        for source in opened_sources:
            source.close()
        raise
    return opened_sources

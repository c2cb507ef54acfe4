"""Compares what a simulated client drew, by SSIM, with all tiles at their finest files."""

__all__ = ["TilePictures"]

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import final

import numpy as np

from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.splats import Splats
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.tiles.format.tileset import Tileset
from gsgen.tiles.loading.leaves import read_contents
from gsgen.tiles.loading.quality_ladder import QualityLadder
from gsgen.tiles.loading.streamed_sog import SogFiles
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.prefetch import ViewSettings
from gsgen.tiles.scoring.score import Picture, draw
from gsgen.tiles.scoring.ssim import ssim
from gsgen.tiles.simulate.client import Simulation
from gsgen.tiles.stores.store import Store


@final
class TilePictures:
    """Draws files of tiles, each of which is read once.

    Args:
        store: Of the tileset.
        tileset: The tileset.
        ladder: Files of its tiles at several qualities; None for one file each.
        view: Of the cameras.
    """

    def __init__(
        self, store: Store, tileset: Tileset, ladder: QualityLadder | None, view: ViewSettings
    ) -> None:
        self._view, self._renderer = view, Renderer()
        tiles, sog_files = list(tileset.tiles()), SogFiles()

        @cache
        def read(row: int, quality: int) -> list[Splats]:
            tile = tiles[row]
            contents = tile.contents
            if ladder:
                contents = (replace(contents[0], uri=ladder.files[row][quality]),)
            entries = [(tile, content) for content in contents]
            placed = read_contents(store, tileset, entries, sog_files)
            return [part.relative_to_origin(np.zeros(3)) for part in placed]

        self._read = read

    def draw(self, pose: Pose, files: Mapping[int, int]) -> Picture:
        """Return the picture of tiles, each with the quality of its file, on black.

        Raises:
            TilesetInvalid: A file is missing or wrong.
        """
        parts = [part for file in files.items() for part in self._read(*file)]
        if not parts:
            return np.zeros((self._view.height, self._view.width, 3), np.float32)
        return draw(self._renderer, join_splats(parts), [self._view.camera(pose)])[0][..., :3]

    def score(self, simulation: Simulation) -> Simulation:
        """Return a simulation with the SSIM of its pictures at the moments that it kept."""
        return replace(
            simulation,
            ssim={
                seconds: ssim(
                    self.draw(moment.pose, moment.drawn),
                    self.draw(moment.pose, dict.fromkeys(moment.wanted, 0)),
                )
                for seconds, moment in simulation.moments.items()
            },
        )

"""Opens the ONNX generators of neural tiles: digest, validation, and a worker that runs each."""

__all__ = ["GeneratorOpener", "ModelReader"]

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, final

from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.validation.finding import Violation
from gsgen.runtime.sources.generator_worker import GeneratorWorker
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.neural_tile import NeuralTile
from gsgen.tiles.loading.neural_model import TileBounds, check_digest, check_neural_model
from gsgen.tiles.selection.tile_tree import TileTree

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels

ModelReader = Callable[[NeuralTile], bytes]


@final
class GeneratorOpener:
    """Opens the ONNX generators of neural tiles; conforming models are validated once only.

    Args:
        tree: Tiles of the tileset, by key.
        read_model: Reads the model of a tile.
        provider: Execution provider of ONNX Runtime.
        confined: Runs the generators in child processes with limits; None runs them in this one.
    """

    def __init__(
        self,
        tree: TileTree,
        read_model: ModelReader,
        provider: str,
        confined: "ConfinedModels | None" = None,
    ) -> None:
        self._tree, self._read_model, self._provider = tree, read_model, provider
        self._confined_models = confined
        self._validated_tiles: set[int] = set()

    def open(self, tile: int) -> tuple[GeneratorWorker, int]:
        """Read, check and open a tile's ONNX generator; return its worker and the model size.

        Raises:
            TilesetInvalid: The model cannot be had, or breaks a promise of the tile.
            GsgenError: ONNX Runtime cannot open the model.
        """
        entry = self._tree.tiles[tile]
        assert entry.neural is not None
        data = self._read_model(entry.neural)
        _raise_first_violation(list(check_digest(data, entry.neural, "model")))
        with temporary_folder() as folder:
            path = folder / "model.onnx"
            path.write_bytes(data)
            if tile not in self._validated_tiles:
                self._require_declarations(tile, entry.neural, path)
                self._validated_tiles.add(tile)
            worker = GeneratorWorker(path, self._provider, confined=self._confined_models)
        try:
            _require_drawable_model(worker)
        except TilesetInvalid:
            worker.close()
            raise
        return worker, len(data)

    def _require_declarations(self, tile: int, neural: NeuralTile, path: Path) -> None:
        """Raise if a tile's ONNX generator breaks a validation rule or the tile's declaration."""
        entry, box = self._tree.tiles[tile], self._tree.box(tile)
        bounds = TileBounds(box, entry.transform)
        limits = self._confined_models.limits if self._confined_models else None
        _raise_first_violation(
            list(check_neural_model(path, entry, neural, "model", bounds=bounds, limits=limits))
        )


def _raise_first_violation(violations: Sequence[Violation]) -> None:
    if violations:
        first = violations[0]
        raise TilesetInvalid(first.actual, expected=first.expected, fault=Fault.NEURAL)


def _require_drawable_model(worker: GeneratorWorker) -> None:
    """Raise if an ONNX generator's Gaussians cannot be blended with those of other tiles."""
    manifest = worker.manifest
    assert manifest.outputs.appearance is not None  # the worker requires it
    for name, actual, expected in (
        ("blend", manifest.blend, "alpha"),
        ("color_space", manifest.outputs.appearance.color_space, "srgb"),
        ("antialias", manifest.antialias, "classic"),
    ):
        if actual != expected:
            raise TilesetInvalid(
                f"the manifest of the tile's ONNX generator has {name} {actual}",
                expected=f"{expected}, which the tiles' stored splats have",
                fault=Fault.NEURAL,
            )

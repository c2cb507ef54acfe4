"""Rules (GT) of neural tiles: the ONNX generator that a tile holds."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.neural_tile import NeuralTile
from gsgen.tiles.format.tileset import Tile
from gsgen.tiles.format.volumes import Region
from gsgen.tiles.loading.neural_model import MAX_MODEL, TileBounds, check_digest, check_neural_model
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.rules.reporting import SCHEMA_RULE, faults_of, tileset_rule


@tileset_rule("GT020", Severity.ERROR, needs=(SCHEMA_RULE, "GT010"))
def neural_content(inspected: InspectedTileset) -> Iterator[Violation]:
    """A neural tile's ONNX generator conforms, has the declared digest, and stays in the tile.

    Why:
        A viewer runs the model instead of drawing the content. One that fails, or that puts
        splats outside of the tile, shows less than the content.

    Hint:
        Check the model alone with `gsgen validate`; let its manifest declare bounds within the
        volume of the tile; write sha256 and splats_max from the model.
    """
    yield from faults_of(inspected, Fault.NEURAL)
    tileset = inspected.tileset
    for tile in tileset.tiles() if tileset else ():
        if tile.neural is not None:
            yield from _check_neural_tile(inspected, tile, tile.neural)


def _check_neural_tile(
    inspected: InspectedTileset, tile: Tile, neural: NeuralTile
) -> Iterator[Violation]:
    location = f"tile {neural.location}"
    if not tile.contents:
        yield Violation.at(
            location, "no content", "splats at the first time, for viewers without generators"
        )
    try:
        data = inspected.store.read(neural.uri, limit=MAX_MODEL)
    except TilesetInvalid as error:
        yield Violation.at(location, f"{neural.uri}: {error.actual}", "the model")
        return
    violations = list(check_digest(data, neural, location))
    yield from violations
    if violations:
        return
    with temporary_folder() as folder:
        path = folder / "model.onnx"
        path.write_bytes(data)
        bounds = _bounds(inspected, tile)
        yield from check_neural_model(path, tile, neural, location, bounds=bounds)


def _bounds(inspected: InspectedTileset, tile: Tile) -> TileBounds:
    """Return a tile's volume: a globe region in the globe's frame, others in the tile's frame."""
    if isinstance(tile.volume, Region) and inspected.tileset is not None:
        return TileBounds(tile.volume, inspected.tileset.transform @ tile.transform)
    return TileBounds(tile.volume, np.eye(4))

"""Rules (GT) of neural tiles: the generator that a tile holds."""

import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.manifest_io import parse
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import rule
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.neural import EXTENSION, NeuralTile
from gsgen.tiles.tileset import Tile
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.kinds import TILESET
from gsgen.tiles.validation.rules.reporting import SCHEMA_RULE, faults_of
from gsgen.tiles.volumes import Box

MAX_MODEL: Final = 1 << 30
_SHARE: Final = 1e-3
_BOUNDS_HOLD: Final = "GV021"  # a warning for a model, as no viewer culls by its bounds


@rule(
    "GT020",
    "neural-content",
    Severity.ERROR,
    over="tileset",
    fixture="tiles_neural_digest",
    needs=(SCHEMA_RULE, "GT010"),
    kinds=(TILESET,),
)
def neural_content(inspected: InspectedTileset) -> Iterator[Violation]:
    """The generator of a neural tile conforms, has the declared digest, and stays in the tile.

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
            yield from _check(inspected, tile, tile.neural)


def _check(inspected: InspectedTileset, tile: Tile, neural: NeuralTile) -> Iterator[Violation]:
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
    digest = hashlib.sha256(data).hexdigest()
    if digest != neural.sha256:
        yield Violation.at(
            f"{location}.sha256", f"{neural.sha256[:12]}…", f"{digest[:12]}…, of {neural.uri}"
        )
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        path.write_bytes(data)
        yield from _check_model(path, tile, neural, location)


def _check_model(path: Path, tile: Tile, neural: NeuralTile, location: str) -> Iterator[Violation]:
    """Check a neural tile's generator against the contract, whose probes test its bounds."""
    from gsgen.contract import Level, Settings, open_model, validate

    settings = Settings(level=Level.VALUES, severities={_BOUNDS_HOLD: Severity.ERROR})
    try:
        report: Report = validate(path, settings)
        text = open_model(path).manifest_text
    except GsgenError as error:
        yield Violation.at(location, f"{neural.uri}: {error.message}", "a Gaussian Generator")
        return
    if report.verdict != "conforms":
        rules = ", ".join(dict.fromkeys(f.rule for f in report.findings if f.counts))
        yield Violation.at(location, f"{neural.uri} breaks {rules}", "a model that conforms")
        return
    manifest = parse(text).manifest if text is not None else None
    if not isinstance(manifest, GeneratorManifest):
        yield Violation.at(location, f"{neural.uri} is of kind {report.kind}", "a generator")
        return
    yield from _check_declarations(manifest, report, tile, neural, location)


def _check_declarations(
    manifest: GeneratorManifest, report: Report, tile: Tile, neural: NeuralTile, location: str
) -> Iterator[Violation]:
    roles = {entry.role for entry in manifest.inputs}
    if roles != set(neural.inputs):
        yield Violation.at(
            f"{location}.inputs",
            ", ".join(neural.inputs),
            f"{', '.join(sorted(roles)) or 'none'}, as the model has",
        )
    if report.capacity is not None and report.capacity > neural.splats_max:
        yield Violation.at(
            f"{location}.splats_max",
            str(neural.splats_max),
            f"{report.capacity} or more, the rows of the model",
        )
    if manifest.bounds is None:
        yield Violation.at(location, f"{neural.uri} declares no bounds", "bounds in the manifest")
        return
    low, high = np.array(manifest.bounds.min), np.array(manifest.bounds.max)
    box = Box((low + high) / 2, np.diag((high - low) / 2))
    out = float(tile.volume.outside(box.samples()).max())
    if out > _SHARE * tile.volume.size:
        yield Violation.at(
            f"tile {tile.location}",
            f"the bounds of {EXTENSION} reach {out:.4g} out of the tile's volume",
            "bounds within the volume",
        )

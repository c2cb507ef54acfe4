"""Checks the ONNX generator of a neural tile against the contract and the tile's declaration."""

__all__ = ["MAX_MODEL", "check_digest", "check_neural_model", "validate_model"]

import hashlib
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
from gsgen.tiles.neural import EXTENSION, NeuralTile
from gsgen.tiles.tileset import Tile
from gsgen.tiles.volumes import Box

MAX_MODEL: Final = 1 << 30
"""Largest model of a neural tile, in bytes."""

_SHARE: Final = 1e-3
_BOUNDS_HOLD: Final = "GV021"  # a warning for a model, as no viewer culls by its bounds


def check_digest(data: bytes, neural: NeuralTile, location: str) -> Iterator[Violation]:
    """Yield a violation if the SHA-256 of a model file differs from the declared digest."""
    digest = hashlib.sha256(data).hexdigest()
    if digest != neural.sha256:
        yield Violation.at(
            f"{location}.sha256", f"{neural.sha256[:12]}…", f"{digest[:12]}…, of {neural.uri}"
        )


def validate_model(path: Path) -> Report:
    """Validate a neural tile's ONNX generator, whose bounds have to hold for all test inputs."""
    from gsgen.contract import Level, Settings, validate

    return validate(path, Settings(level=Level.VALUES, severities={_BOUNDS_HOLD: Severity.ERROR}))


def check_neural_model(
    path: Path, tile: Tile, neural: NeuralTile, location: str
) -> Iterator[Violation]:
    """Check a neural tile's ONNX generator against the contract and the tile's declaration.

    Args:
        path: The model.
        tile: The tile that holds it.
        neural: The declaration.
        location: Of the tile, in violations.
    """
    from gsgen.contract import open_model

    try:
        report = validate_model(path)
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

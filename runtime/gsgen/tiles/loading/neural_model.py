"""Checks a neural tile's ONNX generator against validation rules and the tile's declaration."""

__all__ = ["MAX_MODEL", "TileBounds", "check_digest", "check_neural_model", "require_generator"]

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.errors import GsgenError, HostProcessFailed
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.manifest_io import parse
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.report import Report
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.neural_tile import NEURAL_TILE_EXTENSION, NeuralTile
from gsgen.tiles.format.tileset import Tile
from gsgen.tiles.format.volumes import Box, Volume

MAX_MODEL: Final = 1 << 30
"""Largest model of a neural tile, in bytes."""

_BOUNDS_TOLERANCE: Final = 1e-3
_BOUNDS_RULE: Final = "GV021"  # a warning for a model, as no viewer culls by its bounds


@final
@dataclass(frozen=True, slots=True, eq=False)
class TileBounds:
    """The volume in which a tile's Gaussians have to stay, and the tile-to-volume transform.

    Attributes:
        volume: The volume.
        model_from_tile: From the tile's frame to that of the volume, a similarity.
    """

    volume: Volume
    model_from_tile: Float64[np.ndarray, "4 4"]


def check_digest(data: bytes, neural: NeuralTile, location: str) -> Iterator[Violation]:
    """Yield a violation if the SHA-256 of a model file differs from the declared digest."""
    digest = hashlib.sha256(data).hexdigest()
    if digest != neural.sha256:
        yield Violation.at(
            f"{location}.sha256", f"{neural.sha256[:12]}…", f"{digest[:12]}…, of {neural.uri}"
        )


def require_generator(path: Path, limits: Limits | None = None) -> tuple[GeneratorManifest, Report]:
    """Validate a neural tile's ONNX model; raise unless it is a generator that conforms.

    The bounds of its manifest have to hold for all test inputs. ``limits`` are those of its runs;
    None for those of the validator.

    Raises:
        TilesetInvalid: The model breaks rules, or is of another kind.
        ModelUnreadable: The file is not an ONNX model.
    """
    from gsgen.contract import Level, Settings, open_model, validate

    settings = Settings(
        level=Level.VALUES, severities={_BOUNDS_RULE: Severity.ERROR}, limits=limits or Limits()
    )
    report = validate(path, settings)
    if report.verdict != "conforms":
        rules = ", ".join(
            dict.fromkeys(
                each_finding.rule for each_finding in report.findings if each_finding.counts
            )
        )
        raise TilesetInvalid(
            f"the neural tile's ONNX model breaks the rules {rules}",
            expected="a model that conforms",
            hint="`gsgen validate MODEL` explains each rule.",
            fault=Fault.NEURAL,
        )
    text = open_model(path).manifest_text
    manifest = parse(text).manifest if text is not None else None
    if not isinstance(manifest, GeneratorManifest):
        raise TilesetInvalid(
            f"the neural tile's ONNX model is of kind {report.kind}",
            expected="a generator",
            fault=Fault.NEURAL,
        )
    return manifest, report


def check_neural_model(
    path: Path,
    tile: Tile,
    neural: NeuralTile,
    location: str,
    *,
    bounds: TileBounds,
    limits: Limits | None = None,
) -> Iterator[Violation]:
    """Check a neural tile's ONNX generator against validation rules and the tile's declaration.

    Args:
        path: The model.
        tile: The tile that holds it.
        neural: The declaration.
        location: Of the tile, in violations.
        bounds: Of the tile.
        limits: Of the runs that check the model; None for those of the validator.

    Raises:
        HostProcessFailed: This machine, not the model, ended a run.
    """
    try:
        manifest, report = require_generator(path, limits)
    except HostProcessFailed:
        raise
    except TilesetInvalid as error:
        yield Violation.at(location, f"{neural.uri} {error.actual}", error.expected)
        return
    except GsgenError as error:
        yield Violation.at(location, f"{neural.uri}: {error.message}", "a Gaussian Generator")
        return
    yield from _check_declarations(manifest, report, neural, location)
    if manifest.bounds is None:
        yield Violation.at(location, f"{neural.uri} declares no bounds", "bounds in the manifest")
        return
    low, high = np.array(manifest.bounds.min), np.array(manifest.bounds.max)
    box = Box((low + high) / 2, np.diag((high - low) / 2)).transformed(bounds.model_from_tile)
    overshoot = float(bounds.volume.outside(box.samples()).max())
    if overshoot > _BOUNDS_TOLERANCE * bounds.volume.size:
        yield Violation.at(
            f"tile {tile.location}",
            f"the bounds of {NEURAL_TILE_EXTENSION} reach {overshoot:.4g} out of the tile's volume",
            "bounds within the volume",
        )


def _check_declarations(
    manifest: GeneratorManifest, report: Report, neural: NeuralTile, location: str
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

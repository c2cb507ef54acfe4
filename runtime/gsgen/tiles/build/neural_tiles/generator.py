"""Validates an ONNX generator to become a neural tile, and computes its first-frame splats."""

__all__ = ["Generator", "open_generator"]

import hashlib
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import cast, final

from gsgen.contract.errors import ConfigInvalid
from gsgen.formats import Splats, read_ply
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.json_values import JsonDict
from gsgen.tiles.neural_model import require_generator

_UNSAFE = re.compile(r"[^A-Za-z0-9_.-]+")
_HINT = (
    "A neural tile needs static rows, bounds, and inputs with a range of time, if it has a time."
)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Generator:
    """A Gaussian generator that becomes a neural tile of a tileset, and its first frame.

    Attributes:
        name: Path of its files in the tileset, without a suffix.
        data: The ONNX file.
        sha256: Of the file.
        extension: The object of GSGEN_neural_tile.
        low: Lower corner of its declared bounds, in the frame of the scenes.
        high: Upper corner of the same.
        first_frame: What it draws at the first time, with fitted colours.
    """

    name: str
    data: bytes
    sha256: str
    extension: JsonDict
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    first_frame: Splats


def open_generator(path: Path) -> Generator:
    """Validate an ONNX generator for a neural tile, and compute its first-frame splats.

    Raises:
        ConfigInvalid: The generator does not conform, or lacks what a neural tile needs.
        ModelUnreadable: The file is not an ONNX model.
    """
    from gsgen.runtime.baking.bake_frames import bake

    try:
        manifest, report = require_generator(path)
    except TilesetInvalid as error:
        raise ConfigInvalid(
            f"the model {error.message}",
            where=str(path),
            hint=f"`gsgen validate {path}` explains the findings.",
        ) from error
    roles = sorted({entry.role for entry in manifest.inputs})
    spans = [entry.range for entry in manifest.inputs if entry.role == "time"]
    lacking = {
        "static rows": report.capacity is None,
        "bounds": manifest.bounds is None,
        "inputs": not roles,
        "a range of time": None in spans,
    }
    if any(lacking.values()):
        names = ", ".join(name for name, is_lacking in lacking.items() if is_lacking)
        raise ConfigInvalid(f"the generator lacks {names}", where=str(path), hint=_HINT)
    assert manifest.bounds is not None
    first = spans[0][0] if spans and spans[0] else None
    with tempfile.TemporaryDirectory() as folder:
        frame = Path(folder) / "frame.ply"
        bake(path, frame, time=first, psnr=False)
        splats = cast(Splats, read_ply(frame))
    data = path.read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    name = f"n/{_UNSAFE.sub('-', path.stem)}-{digest[:8]}"
    extension: JsonDict = {
        "uri": f"{name}.onnx",
        "contract": manifest.contract,
        "sha256": digest,
        "inputs": roles,
        "splats_max": report.capacity,
    }
    if spans:
        extension["time_range"] = list(spans[0] or ())
    return Generator(
        name=name,
        data=data,
        sha256=digest,
        extension=extension,
        low=manifest.bounds.min,
        high=manifest.bounds.max,
        first_frame=splats,
    )

"""Makes an ONNX generator a neural tile: validates it, and adds it with its first-frame splats."""

__all__ = ["Generator", "add_neural_tiles", "open_generator"]

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast, final

import numpy as np

from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.drafts import temporary_folder
from gsgen.formats import Splats, read_ply
from gsgen.formats.shared.files import replace_file
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.format.extensions import CodecName
from gsgen.tiles.format.index import ContentRecord, TileRecord
from gsgen.tiles.format.json_values import JsonDict
from gsgen.tiles.gltf.encoding import write_content
from gsgen.tiles.loading.neural_model import require_generator

_UNSAFE_CHARACTERS = re.compile(r"[^A-Za-z0-9_.-]+")
_REQUIREMENTS_HINT = (
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
            hint=f"`gsgen validate {for_shell(str(path))}` explains the findings.",
        ) from error
    roles = sorted({entry.role for entry in manifest.inputs})
    spans = [entry.range for entry in manifest.inputs if entry.role == "time"]
    requirement_missing = {
        "static rows": report.capacity is None,
        "bounds": manifest.bounds is None,
        "inputs": not roles,
        "a range of time": None in spans,
    }
    if any(requirement_missing.values()):
        names = ", ".join(name for name, is_missing in requirement_missing.items() if is_missing)
        raise ConfigInvalid(
            f"the generator lacks {names}", where=str(path), hint=_REQUIREMENTS_HINT
        )
    assert manifest.bounds is not None
    first = spans[0][0] if spans and spans[0] else None
    with temporary_folder() as folder:
        frame = folder / "frame.ply"
        bake(path, frame, time=first, psnr=False)
        splats = cast(Splats, read_ply(frame))
    data = path.read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    name = f"n/{_UNSAFE_CHARACTERS.sub('-', path.stem)}-{digest[:8]}"
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


def add_neural_tiles(
    root: TileRecord,
    generators: Sequence[Generator],
    output: Path,
    *,
    codec: CodecName,
    color_space: str,
    antialiased: bool,
) -> tuple[TileRecord, dict[str, tuple[int, str]]]:
    """Write the files of neural tiles, and join these tiles with the scenes' tile tree.

    Returns:
        A root without content, above the tree and the neural tiles, and the written files.

    Raises:
        ConfigInvalid: A generator has another colour space than the scenes.
    """
    files: dict[str, tuple[int, str]] = {}
    leaves: list[TileRecord] = []
    for generator in generators:
        splats = replace(generator.first_frame, antialiased=antialiased)
        if splats.color_space != color_space:
            raise ConfigInvalid(
                f"color_space is {splats.color_space}; expected {color_space}, as in the splat scenes",
                where=str(generator.extension["uri"]),
            )
        encoded = write_content(splats, splats.position.mean(axis=0, dtype=np.float64), codec=codec)
        digest = hashlib.sha256(encoded.data).hexdigest()
        uri = f"{generator.name}-{digest[:8]}.glb"
        for path, data, sha256 in (
            (uri, encoded.data, digest),
            (f"{generator.name}.onnx", generator.data, generator.sha256),
        ):
            (output / path).parent.mkdir(parents=True, exist_ok=True)
            with replace_file(output / path) as file:
                file.write(data)
            files[path] = len(data), sha256
        content = ContentRecord(uri=uri, size=len(encoded.data), low=encoded.low, high=encoded.high)
        leaves.append(
            TileRecord(
                level=1,
                coordinates=(0, 0, 0),
                low=np.minimum(encoded.low, generator.low),
                high=np.maximum(encoded.high, generator.high),
                geometric_error=0.0,
                splats=encoded.splats,
                contents=(content,),
                neural=generator.extension,
            )
        )
    low = np.min([tile.low for tile in (root, *leaves)], axis=0)
    high = np.max([tile.high for tile in (root, *leaves)], axis=0)
    new_root = TileRecord(
        level=0,
        coordinates=(0, 0, 0),
        low=low,
        high=high,
        geometric_error=max(root.geometric_error, float(np.linalg.norm(high - low))),
        children=(root, *leaves),
        refine="ADD",
    )
    return new_root, files

"""Adds ONNX generators to a tile tree, with first-frame splats that all viewers draw."""

__all__ = ["add_neural_tiles"]

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.formats.shared.files import replacing
from gsgen.tiles.build.neural_tiles.generator import Generator
from gsgen.tiles.gltf.encoding import CodecName, write_content
from gsgen.tiles.index import ContentRecord, TileRecord


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
            with replacing(output / path) as file:
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
    above = TileRecord(
        level=0,
        coordinates=(0, 0, 0),
        low=low,
        high=high,
        geometric_error=max(root.geometric_error, float(np.linalg.norm(high - low))),
        children=(root, *leaves),
        refine="ADD",
    )
    return above, files

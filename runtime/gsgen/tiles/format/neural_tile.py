"""Neural tiles: the extension GSGEN_neural_tile, by which a tile holds an ONNX generator.

The content of such a tile stays a file of splats, which every viewer can draw; a viewer that
knows the extension may run the model instead. It is used and never required.
"""

__all__ = ["NEURAL_TILE_EXTENSION", "NeuralTile", "neural_schema", "read_neural_tile"]

import re
from dataclasses import dataclass
from typing import Final, final

from gsgen.contract.spec.fields.roles import ROLES
from gsgen.contract.spec.upgrades import CONTRACT_VERSION
from gsgen.tiles.errors import Fault
from gsgen.tiles.format.json_values import JsonDict, JsonObject
from gsgen.tiles.format.uris import resolve_uri

NEURAL_TILE_EXTENSION: Final = "GSGEN_neural_tile"
MAX_SPLATS: Final = 1 << 24

_DIGEST_PATTERN = re.compile(r"^[0-9a-f]{64}$")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NeuralTile:
    """The declaration of the ONNX generator that a neural tile holds.

    Attributes:
        uri: The ONNX model, relative to the tileset's folder.
        sha256: Digest of the model, in hexadecimal.
        inputs: Roles of the inputs that the viewer gives, such as ``view`` and ``time``.
        splats_max: The most splats that a run gives.
        time_range: First and last time in seconds; None for a model without time.
        location: Where the extension stands.
    """

    uri: str
    sha256: str
    inputs: tuple[str, ...]
    splats_max: int
    time_range: tuple[float, float] | None
    location: str


def read_neural_tile(extension: JsonObject, base: str) -> NeuralTile:
    """Parse the extension object ``GSGEN_neural_tile`` of a tile.

    Args:
        extension: The object.
        base: Path of the file that it stands in, relative to the tileset's folder.

    Raises:
        TilesetInvalid: A member is missing or is not what the schema says.
    """
    members = JsonObject(extension.values, extension.location, Fault.NEURAL)
    if members.text("contract") != CONTRACT_VERSION:
        members.refuse("contract", CONTRACT_VERSION)
    digest = members.text("sha256")
    if not _DIGEST_PATTERN.match(digest):
        members.refuse("sha256", "64 hexadecimal digits")
    inputs = members.texts("inputs")
    if not inputs or len(set(inputs)) < len(inputs) or not set(inputs) <= ROLES.keys():
        members.refuse("inputs", "roles of inputs, such as view and time, each once")
    span = None
    if "time_range" in members:
        first, last = map(float, members.numbers("time_range", 2))
        if first > last:
            members.refuse("time_range", "the first time, then a last one that is not before it")
        span = first, last
    if ("time" in inputs) != (span is not None):
        members.refuse("time_range", "a range where the inputs have a time, and none otherwise")
    return NeuralTile(
        uri=resolve_uri(base, members.text("uri"), members.at("uri")),
        sha256=digest,
        inputs=inputs,
        splats_max=members.whole("splats_max", least=1, most=MAX_SPLATS),
        time_range=span,
        location=members.location,
    )


def neural_schema() -> JsonDict:
    """Return the JSON Schema of the extension GSGEN_neural_tile."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": NEURAL_TILE_EXTENSION,
        "description": "A Gaussian Generator that a viewer may run instead of the content.",
        "type": "object",
        "required": ["uri", "contract", "sha256", "inputs", "splats_max"],
        "additionalProperties": False,
        "properties": {
            "uri": {
                "type": "string",
                "minLength": 1,
                "description": "The ONNX model, relative to this file.",
            },
            "contract": {
                "const": CONTRACT_VERSION,
                "description": "Version of the contract that the model keeps.",
            },
            "sha256": {
                "type": "string",
                "pattern": _DIGEST_PATTERN.pattern,
                "description": "Digest of the model.",
            },
            "inputs": {
                "type": "array",
                "minItems": 1,
                "uniqueItems": True,
                "items": {"enum": sorted(ROLES)},
                "description": "Roles of the inputs that the viewer gives.",
            },
            "splats_max": {
                "type": "integer",
                "minimum": 1,
                "maximum": MAX_SPLATS,
                "description": "The most splats that a run gives.",
            },
            "time_range": {
                "type": "array",
                "minItems": 2,
                "maxItems": 2,
                "items": {"type": "number"},
                "description": "First and last time in seconds; with an input time only.",
            },
            "extensions": {"type": "object"},
            "extras": {},
        },
        "if": {"properties": {"inputs": {"contains": {"const": "time"}}}},
        "then": {"required": ["time_range"]},
        "else": {"not": {"required": ["time_range"]}},
    }

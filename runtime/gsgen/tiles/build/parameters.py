"""The parameters of a tileset build, and the key under which an earlier result is reused."""

__all__ = ["ALGORITHM_VERSION", "BuildParameters"]

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final, final

from gsgen.formats.shared.origins import Origin
from gsgen.tiles.format.extensions import CodecName
from gsgen.tiles.format.json_values import JsonDict

ALGORITHM_VERSION: Final = 6
"""Version of the algorithm: increased when equal inputs and parameters give other bytes."""


_IMPLICIT_LEAVES: Final = 1000  # full leaves: a scene has about twice as many tiles


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BuildParameters:
    """All options that decide, besides the scenes, the bytes of a built tileset.

    The engine, the number of workers and how the work is divided are missing on purpose: no byte
    depends on them.

    Attributes:
        leaf: Most splats of a leaf.
        codec: How contents are written.
        is_streamed_sog: Whether a streamed SOG is written in place of a tileset.
        qualities: Qualities of :data:`gsgen.tiles.gltf.encoding.SPZ_QUALITIES` that are written, finest
            first.
        implicit: Whether the tree is an implicit octree; None for scenes of about 2,000 tiles or
            more, which have a short index so.
        transform: Of the root tile, scene → world: 16 numbers, column by column.
        turn_upright: Whether the scenes' declared upward direction is first turned to that of
            3DGS training, -y, which ``transform`` is for.
        origin: The point of the scenes that is 0, 0, 0 in the root frame; None for one that
            float32 needs.
    """

    leaf: int = 8_192
    codec: CodecName = "spz"
    is_streamed_sog: bool = False
    qualities: tuple[int, ...] = (0, 2, 4)
    implicit: bool | None = None
    transform: tuple[float, ...]
    turn_upright: bool = False
    origin: Origin | None = None

    @property
    def is_anchored(self) -> bool:
        """Whether large splats become leaves of their own, above the cells of small ones."""
        return not (self.implicit or self.is_streamed_sog)

    def is_implicit(self, splats: int) -> bool:
        """Return whether the tree of a scene of some splats is an implicit octree."""
        return splats >= _IMPLICIT_LEAVES * self.leaf if self.implicit is None else self.implicit

    def as_dict(self) -> JsonDict:
        """Return the build parameters as a JSON object."""
        return json.loads(json.dumps(asdict(self)))  # type: ignore[no-any-return]

    def key(self, inputs: Sequence[str]) -> str:
        """Return the SHA-256 of gsgen's version, the build parameters and the scenes' digests."""
        content = {
            "version": ALGORITHM_VERSION,
            "parameters": self.as_dict(),
            "inputs": list(inputs),
        }
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

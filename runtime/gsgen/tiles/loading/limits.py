"""Limits of reading a tileset, and the handling of its faults."""

__all__ = ["Limits", "LoadReport", "StrictReport"]

from dataclasses import dataclass
from typing import Protocol, final

from gsgen.tiles.errors import TilesetInvalid


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Upper limits of reading a tileset.

    Attributes:
        tiles: How many tiles of all files together.
        depth: How many levels of tiles.
        documents: How many indices and subtrees.
        nesting: How many external tilesets within each other.
        index_bytes: Bytes of all indices and subtrees together.
    """

    tiles: int = 400_000
    depth: int = 200
    documents: int = 50_000
    nesting: int = 32
    index_bytes: int = 512 << 20


class LoadReport(Protocol):
    """Protocol: receives every fault of a tileset, so that reading continues with the rest."""

    def note(self, error: TilesetInvalid) -> None:
        """Handle a fault that leaves all parts of the tileset readable."""
        ...

    def drop(self, error: TilesetInvalid) -> None:
        """Handle a fault by which a part of the tileset is left out; may raise the fault."""
        ...


@final
class StrictReport:
    """Raises faults that make a part of a tileset unreadable, and ignores all other faults."""

    def note(self, error: TilesetInvalid) -> None:
        """Ignore a fault that leaves all parts of the tileset readable."""

    def drop(self, error: TilesetInvalid) -> None:
        """Raise a fault by which a part of the tileset would be left out."""
        raise error

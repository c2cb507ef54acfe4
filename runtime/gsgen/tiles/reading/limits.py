"""How much of a tileset is read, and who is told of its faults."""

__all__ = ["Limits", "LoadReport", "Strict"]

from dataclasses import dataclass
from typing import Protocol, final

from gsgen.tiles.errors import TilesetInvalid


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much of a tileset is read.

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
    """Is told of every fault, so that reading can go on with the rest."""

    def note(self, error: TilesetInvalid) -> None:
        """Take a fault that hides nothing: the part is read all the same."""
        ...

    def drop(self, error: TilesetInvalid) -> None:
        """Take a fault because of which a part is left out; may raise it."""
        ...


@final
class Strict:
    """Raises what cannot be read, and passes over what can."""

    def note(self, error: TilesetInvalid) -> None:
        """Pass over it."""

    def drop(self, error: TilesetInvalid) -> None:
        """Raise it."""
        raise error

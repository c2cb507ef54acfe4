"""Limits of reading a tileset, and the handling of its faults."""

__all__ = ["Limits", "LoadReport", "LoadingTime", "StrictReport"]

from dataclasses import dataclass
from typing import Final, Protocol, final

from gsgen.contract.fetching.deadline import FETCH_SECONDS, Deadline, fetch_seconds
from gsgen.tiles.errors import Fault, StoreUnavailable, TilesetInvalid
from gsgen.tiles.format.json_values import JsonObject

_FILE_TIMEOUT_SECONDS: Final = 60.0
_LOADING_FILES: Final = 5  # a tree of many files may take as long as so many slow ones


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


@final
class LoadingTime:
    """The time in which the tree of a tileset has to be read, however many files it has.

    Args:
        name: Of the tileset, for the error.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._seconds = _LOADING_FILES * fetch_seconds(_FILE_TIMEOUT_SECONDS)
        self._deadline = Deadline(self._seconds)

    def require(self, progress: str) -> None:
        """Raise if the time is over.

        Args:
            progress: The files that were read so far.

        Raises:
            StoreUnavailable: The time is over.
        """
        if self._deadline.remaining <= 0:
            raise StoreUnavailable(
                f"reading the tileset took {self._seconds:g} s; {progress} had come",
                location=self._name,
                hint=f"{FETCH_SECONDS} sets the seconds for a file; all may take "
                f"{_LOADING_FILES} times as long.",
                fault=Fault.CONTENT,
            )


class LoadReport(Protocol):
    """Protocol: receives every fault of a tileset, so that reading continues with the rest."""

    def note(self, error: TilesetInvalid) -> None:
        """Handle a fault that leaves all parts of the tileset readable."""
        ...

    def drop(self, error: TilesetInvalid) -> None:
        """Handle a fault by which a part of the tileset is left out; may raise the fault."""
        ...

    def inspect(self, document: JsonObject, schema: JsonObject | None) -> None:
        """Look at a ``tileset.json`` and its metadata schema, before its tiles are read."""
        ...

    def inspect_subtree(self, document: JsonObject) -> None:
        """Look at the JSON of a subtree, before its bits are read."""
        ...


@final
class StrictReport:
    """Raises faults that make a part of a tileset unreadable, and ignores all other faults."""

    def note(self, error: TilesetInvalid) -> None:
        """Ignore a fault that leaves all parts of the tileset readable."""

    def drop(self, error: TilesetInvalid) -> None:
        """Raise a fault by which a part of the tileset would be left out."""
        raise error

    def inspect(self, document: JsonObject, schema: JsonObject | None) -> None:
        """Look at nothing: a reader takes the members that it needs."""

    def inspect_subtree(self, document: JsonObject) -> None:
        """Look at nothing, likewise."""

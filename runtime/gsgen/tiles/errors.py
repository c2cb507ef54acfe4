"""Errors about tilesets, each with the location of the fault in a file."""

__all__ = ["ContentMissing", "Fault", "StoreUnavailable", "TilesetInvalid"]

from enum import StrEnum

from gsgen.contract.errors import InputUnreadable


class Fault(StrEnum):
    """The kinds of faults of a tileset; each value is the id of the rule for the fault."""

    SCHEMA = "GT001"
    CONTENT = "GT005"
    COUNTS = "GT006"
    SPZ_VERSION = "GT009"
    URI = "GT010"
    TRANSFORM = "GT011"
    VALUES = "GT012"
    SUBTREE = "GT013"
    NEURAL = "GT020"


class TilesetInvalid(InputUnreadable):
    """Raised if a tileset, or one of its files, violates 3D Tiles or gsgen's splat profile.

    Attributes:
        actual: What the file holds.
        location: The file and the JSON path or byte in it.
        expected: What the specification asks for; may be empty.
        hint: What to do next; may be empty.
        fault: Which kind of fault it is.
    """

    def __init__(
        self,
        actual: str,
        *,
        location: str = "",
        expected: str = "",
        hint: str = "",
        fault: Fault = Fault.SCHEMA,
    ) -> None:
        self.actual, self.location, self.expected = actual, location, expected
        self.hint, self.fault = hint, fault
        text = f"{actual}; expected {expected}" if expected else actual
        super().__init__(text, where=location, hint=hint)


class ContentMissing(TilesetInvalid):
    """Raised if a file that a tileset refers to does not exist."""


class StoreUnavailable(TilesetInvalid):
    """Raised if a tileset's files cannot be read now: a server error, a timeout, no connection."""

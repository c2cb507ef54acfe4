"""The abstract class of a file at an address."""

__all__ = ["ByteProgress", "RemoteFile", "ignore_progress"]

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import BinaryIO

ByteProgress = Callable[[str, int, int | None], None]
"""Called with an address, the bytes that have come, and the size of the file where it is known."""


def ignore_progress(address: str, received: int, total: int | None) -> None:
    """Report no progress."""


class RemoteFile(ABC):
    """A file at an address.

    Attributes:
        address: As the user typed it.
    """

    address: str

    @abstractmethod
    def copy(self, into: BinaryIO, *, max_bytes: int, on_bytes: ByteProgress) -> None:
        """Copy the file into an empty one on disk.

        Raises:
            InputUnreadable: It cannot be had, or has more than ``max_bytes`` bytes.
        """

    @abstractmethod
    def read_start(self, size: int) -> bytes:
        """Return the first bytes of the file.

        Raises:
            InputUnreadable: It cannot be had.
        """

    @abstractmethod
    def beside(self, location: str) -> "RemoteFile | None":
        """Return the file that another one names by a relative path; None if it has no address."""

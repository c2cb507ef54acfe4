"""Files of object stores (``s3://``, ``gs://``, ``az://``, …), which fsspec reads."""

__all__ = ["StoredFile"]

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, BinaryIO, Final, final

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.fetching.deadline import FETCH_SECONDS, Deadline, large_file_deadline
from gsgen.contract.fetching.errors import FileMissing, ResponseTooLarge, ServerUnavailable
from gsgen.contract.inputs.addresses import folder_of
from gsgen.contract.inputs.remote_file import ByteProgress, RemoteFile

_CHUNK_BYTES: Final = 4 << 20
_MAX_REASON_LENGTH: Final = 200


@final
@dataclass(frozen=True, slots=True)
class StoredFile(RemoteFile):
    """A file of an object store.

    Attributes:
        address: As the user typed it.
        deadline: Of this file and those beside it, together; looked at after each piece.
    """

    address: str
    deadline: Deadline = field(default_factory=large_file_deadline)

    def copy(self, into: BinaryIO, *, max_bytes: int, on_bytes: ByteProgress) -> None:
        """Copy the file into an empty one on disk."""
        with self._open() as file:
            total = getattr(file, "size", None)
            while piece := self._read(file, _CHUNK_BYTES):
                if into.tell() + len(piece) > max_bytes:
                    raise ResponseTooLarge(f"has more than {max_bytes:,} bytes", where=self.address)
                into.write(piece)
                on_bytes(self.address, into.tell(), total)

    def read_start(self, size: int) -> bytes:
        """Return the first bytes of the file."""
        with self._open() as file:
            return self._read(file, size)

    def beside(self, location: str) -> "StoredFile":
        """Return the file at a relative path."""
        return replace(self, address=folder_of(self.address) + location)

    def _read(self, file: Any, size: int) -> bytes:
        if self.deadline.remaining <= 0:
            raise ServerUnavailable(
                f"the file did not come within {self.deadline.seconds:g} s",
                where=self.address,
                hint=f"{FETCH_SECONDS} sets the seconds for a file.",
            )
        with self._translate_failures():
            piece: bytes = file.read(size)
            return piece

    @contextmanager
    def _open(self) -> Iterator[Any]:
        with self._translate_failures():
            file = _fsspec(self.address).open(self.address, "rb").open()
        with file:
            yield file

    @contextmanager
    def _translate_failures(self) -> Iterator[None]:
        """Translate the exceptions of fsspec and of its packages, which may be any."""
        scheme = self.address.partition("://")[0]
        try:
            yield
        except InputUnreadable:
            raise
        except ImportError as error:
            package = _package_of(scheme)
            raise InputUnreadable(
                f"needs {package}, which is not installed",
                where=self.address,
                hint=f"pip install 'gsgen[stores]' {package}",
            ) from error
        except FileNotFoundError as error:
            raise FileMissing(
                "the store has no such file", where=self.address, hint="Check the address."
            ) from error
        except Exception as error:
            reason = " ".join(str(error).split())[:_MAX_REASON_LENGTH]
            raise ServerUnavailable(
                f"cannot be read: {reason or type(error).__name__}",
                where=self.address,
                hint="fsspec takes keys and other settings from the store's own environment "
                f"variables, or from FSSPEC_{scheme.upper()}.",
            ) from error


def _fsspec(address: str) -> Any:
    """Import fsspec, and raise for an address of an unknown kind."""
    try:
        import fsspec
    except ImportError as error:
        raise InputUnreadable(
            "is read by fsspec, which is not installed",
            where=address,
            hint="pip install 'gsgen[stores]'",
        ) from error
    scheme = address.partition("://")[0]
    # A chain such as `simplecache::s3://…` would read more than the named file.
    if scheme not in fsspec.available_protocols() or "::" in address:
        raise InputUnreadable(
            f"{scheme}:// is not known",
            where=address,
            hint="Addresses are http, https, hf, and those of fsspec, such as s3, gs and az.",
        )
    return fsspec


def _package_of(scheme: str) -> str:
    """Return the package that fsspec needs for a kind of store."""
    from fsspec.registry import known_implementations

    module: str = known_implementations[scheme]["class"]
    return module.partition(".")[0]

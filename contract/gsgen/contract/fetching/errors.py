"""Errors of reading files from web servers: one class for each thing that a user can do."""

__all__ = [
    "AddressNotAllowed",
    "FetchFailed",
    "FileMissing",
    "ResponseTooLarge",
    "ServerUnavailable",
]

from typing import final

from gsgen.contract.errors import InputUnreadable


class FetchFailed(InputUnreadable):
    """Base class of the errors of reading a file from a web server; ``where`` is its address."""


@final
class AddressNotAllowed(FetchFailed):
    """Raised if an address is malformed, or a redirect leads to an origin that is not allowed."""


@final
class FileMissing(FetchFailed):
    """Raised if a web server has no such file."""


@final
class ResponseTooLarge(FetchFailed):
    """Raised if a file of a web server has more bytes than the caller allows."""


@final
class ServerUnavailable(FetchFailed):
    """Raised if a web server cannot be reached, answers an error, or takes too long.

    Attributes:
        is_transient: Whether another attempt may succeed at once.
        retry_after: Seconds that the server asks to wait before it.
    """

    def __init__(
        self,
        message: str,
        *,
        where: str,
        hint: str = "",
        is_transient: bool = False,
        retry_after: float = 0.0,
    ) -> None:
        super().__init__(message, where=where, hint=hint)
        self.is_transient, self.retry_after = is_transient, retry_after

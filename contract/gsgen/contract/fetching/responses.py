"""The part of a file that a request asks for, and the checks of a response's headers."""

__all__ = ["FilePart", "check_status"]

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from http.client import HTTPResponse
from typing import Final, final

from gsgen.contract.fetching.errors import FileMissing, ResponseTooLarge, ServerUnavailable

_NOT_FOUND_STATUSES: Final = (404, 410)
_REFUSED_STATUSES: Final = (401, 403)
_NOT_FOUND_HINT: Final = "Check the address: the server has no such file."
_REFUSED_HINT: Final = "The file is not public, or its link has expired: ask for another link."
_TRANSIENT_STATUSES: Final = (429, 500, 502, 503, 504)
_MAX_RETRY_AFTER_DIGITS: Final = 15  # of a Retry-After


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FilePart:
    """The bytes of a file that are requested, and the most that are taken.

    Attributes:
        address: Of the file.
        start: The first byte.
        size: How many; None for all that follow.
        max_bytes: More is an error.
        max_undeclared: Most bytes of a response that is compressed or declares no length.
        validator: Of the version that is there: its ``ETag``, or when it was last modified.
    """

    address: str
    start: int = 0
    size: int | None = None
    max_bytes: int
    max_undeclared: int
    validator: str = ""

    @property
    def headers(self) -> dict[str, str]:
        """The headers of a request for a range of bytes, or for another version than the one here."""
        if self.validator:
            is_tag = self.validator.endswith('"')
            return {"If-None-Match" if is_tag else "If-Modified-Since": self.validator}
        if not self.start and self.size is None:
            return {}
        last = "" if self.size is None else str(self.start + self.size - 1)
        return {"Range": f"bytes={self.start}-{last}"}

    def bytes_before(self, response: HTTPResponse) -> int:
        """Return how many bytes of a response come before those that were requested."""
        if response.status != 206:
            return self.start
        content_range = response.getheader("Content-Range", "")
        if not content_range.replace(" ", "").startswith(f"bytes{self.start}-"):
            raise ServerUnavailable(
                f"the server sends the range {content_range!r:.80}; expected one from "
                f"byte {self.start}",
                where=self.address,
            )
        return 0

    def budget(self, response: HTTPResponse) -> int:
        """Return how many bytes a response may have; raise if it declares more."""
        if response.length is None or response.getheader("Content-Encoding"):
            return min(self.max_bytes, self.max_undeclared)
        if self.size is None and response.length > self.max_bytes + self.start:
            raise self._too_large_error(f"{response.length:,} bytes", self.max_bytes)
        return self.max_bytes

    def select(self, chunks: Iterator[bytes], before: int, budget: int) -> Iterator[bytes]:
        """Yield the requested bytes of a response's pieces; raise if there are too many."""
        position, received_byte_count = 0, 0
        for chunk in chunks:
            piece = chunk[max(0, before - position) :]
            position += len(chunk)
            if self.size is not None:
                piece = piece[: self.size - received_byte_count]
            received_byte_count += len(piece)
            if received_byte_count > budget:
                raise self._too_large_error(f"{received_byte_count:,} bytes or more", budget)
            yield piece
            if received_byte_count == self.size:
                return

    def _too_large_error(self, actual: str, budget: int) -> ResponseTooLarge:
        return ResponseTooLarge(f"{actual}; expected {budget:,} bytes or fewer", where=self.address)


def check_status(response: HTTPResponse, address: str, headers: Mapping[str, str]) -> None:
    """Raise for a response that does not answer a request with these headers."""
    status = response.status
    expected = (206, 416) if "Range" in headers else (304,) if headers else ()
    if status == 200 or status in expected:
        return
    if status in _NOT_FOUND_STATUSES:
        raise FileMissing(f"the server answers {status}", where=address, hint=_NOT_FOUND_HINT)
    wait = _retry_after_seconds(response.getheader("Retry-After", ""))
    suffix = f", and asks to wait {wait:,.0f} s" if wait else ""
    raise ServerUnavailable(
        f"the server answers {status}{suffix}",
        where=address,
        hint=_REFUSED_HINT if status in _REFUSED_STATUSES else "",
        is_transient=status in _TRANSIENT_STATUSES,
        retry_after=wait,
    )


def _retry_after_seconds(text: str) -> float:
    """Return the seconds of a ``Retry-After`` header, which may be a date; 0 if malformed."""
    if text.isascii() and text.isdigit():
        return float(text[:_MAX_RETRY_AFTER_DIGITS])
    try:
        date = parsedate_to_datetime(text)
        return max(0.0, (date - datetime.now(date.tzinfo or UTC)).total_seconds())
    except (ValueError, TypeError, OverflowError):
        return 0.0

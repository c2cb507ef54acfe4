"""Files of web servers, and of the Hugging Face Hub, which is one."""

__all__ = ["WebFile", "hub_file", "web_file"]

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import BinaryIO, Final, final
from urllib.parse import quote, urlsplit

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.fetching.client import WebClient
from gsgen.contract.fetching.deadline import Deadline, large_file_deadline
from gsgen.contract.fetching.errors import FetchFailed, FileMissing, ServerUnavailable
from gsgen.contract.inputs.addresses import folder_of
from gsgen.contract.inputs.remote_file import ByteProgress, RemoteFile

HUB_ENDPOINT: Final = "https://huggingface.co"
_ENDPOINT_VARIABLE, _TOKEN_VARIABLE = "HF_ENDPOINT", "HF_TOKEN"
_REPOSITORY_KINDS: Final = ("datasets", "spaces", "models")
# A revision is a branch, a tag or a commit; those of pull requests have slashes.
_HUB_PATTERN: Final = re.compile(
    r"(?P<owner>[\w.-]+)/(?P<name>[\w.-]+)"
    r"(?:@(?P<revision>refs/(?:pr|convert)/[\w.-]+|[^/@]+))?/(?P<path>.+)"
)
_HUB_FORM: Final = "hf://OWNER/NAME[@REVISION]/FILE, or hf://datasets/OWNER/NAME/FILE"
_TOKEN_HINT: Final = (
    "Check the address. A private or gated repository needs the environment variable HF_TOKEN: "
    "https://huggingface.co/settings/tokens makes one."
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class WebFile(RemoteFile):
    """A file of a web server.

    Attributes:
        address: As the user typed it.
        url: Of the request, http or https.
        headers: Sent to the origin of the URL, and to no other.
        is_hub: Whether the server is the Hub, whose redirects lead to servers of storage.
        deadline: Of this file and those beside it, together.
    """

    address: str
    url: str
    headers: Mapping[str, str]
    is_hub: bool
    deadline: Deadline

    def copy(self, into: BinaryIO, *, max_bytes: int, on_bytes: ByteProgress) -> None:
        """Copy the file into an empty one on disk."""
        with self._client() as client, self._translate_failures():
            client.copy(
                self.url,
                into,
                max_bytes=max_bytes,
                on_bytes=lambda received, total: on_bytes(self.address, received, total),
                deadline=self.deadline,
            )

    def read_start(self, size: int) -> bytes:
        """Return the first bytes of the file."""
        with self._client() as client, self._translate_failures():
            return client.read(self.url, max_bytes=size, size=size)

    def beside(self, location: str) -> "WebFile | None":
        """Return the file at a relative path; None for one beside a signed address."""
        if urlsplit(self.url).query:
            return None
        path = quote(location)
        return replace(
            self, address=folder_of(self.address) + location, url=folder_of(self.url) + path
        )

    def _client(self) -> WebClient:
        return WebClient(self.url, headers=self.headers, allow_public_hosts=self.is_hub)

    @contextmanager
    def _translate_failures(self) -> Iterator[None]:
        """Name the typed address in errors, and what the Hub asks for."""
        try:
            yield
        except FetchFailed as error:
            error.where = self.address
            is_refused = isinstance(error, FileMissing | ServerUnavailable) and error.hint
            if self.is_hub and is_refused and not isinstance(error.__cause__, OSError):
                error.hint = _TOKEN_HINT
            raise


def web_file(address: str) -> WebFile:
    """Return the file at an http or https address."""
    return WebFile(
        address=address, url=address, headers={}, is_hub=False, deadline=large_file_deadline()
    )


def hub_file(address: str) -> WebFile:
    """Return the file at an address of the Hub, ``hf://OWNER/NAME[@REVISION]/FILE``.

    The environment variables are those of huggingface_hub: ``HF_ENDPOINT`` is the server,
    ``HF_TOKEN`` the token, which no other server receives.

    Raises:
        InputUnreadable: The address is malformed.
        ConfigInvalid: ``HF_ENDPOINT`` or ``HF_TOKEN`` is.
    """
    text = address.partition("://")[2]
    kind, _, remainder = text.partition("/")
    prefix = ""
    if kind in _REPOSITORY_KINDS and remainder.count("/") >= 2:
        text, prefix = remainder, "" if kind == "models" else f"{kind}/"
    match = _HUB_PATTERN.fullmatch(text)
    if match is None or {".", ".."} & {match["owner"], match["name"], *match["path"].split("/")}:
        raise InputUnreadable(
            "is not the address of a file on the Hub", where=address, hint=f"Write {_HUB_FORM}."
        )
    endpoint = (os.environ.get(_ENDPOINT_VARIABLE) or HUB_ENDPOINT).rstrip("/")
    if urlsplit(endpoint).scheme not in ("http", "https"):
        raise ConfigInvalid(
            f"{endpoint!r} is not a web address", where=f"environment variable {_ENDPOINT_VARIABLE}"
        )
    revision = quote(match["revision"] or "main", safe="")
    repository = f"{endpoint}/{prefix}{match['owner']}/{match['name']}"
    url = f"{repository}/resolve/{revision}/{quote(match['path'])}"
    return WebFile(
        address=address,
        url=url,
        headers=_token_header(),
        is_hub=True,
        deadline=large_file_deadline(),
    )


def _token_header() -> dict[str, str]:
    token = os.environ.get(_TOKEN_VARIABLE, "").strip()
    if not token:
        return {}
    if not (token.isascii() and token.isprintable()) or " " in token:
        raise ConfigInvalid(
            "the token has characters that no token has",
            where=f"environment variable {_TOKEN_VARIABLE}",
        )
    return {"Authorization": f"Bearer {token}"}

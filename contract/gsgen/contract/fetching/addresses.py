"""Parses web addresses: origins, paths and queries."""

__all__ = ["Origin", "WebAddress", "parse_address", "parse_origin"]

from typing import Final, NamedTuple, final
from urllib.parse import quote, urlsplit

from gsgen.contract.errors import ConfigInvalid

_DEFAULT_PORTS: Final = {"http": 80, "https": 443}
_PATH_CHARACTERS: Final = "/%:@!$&'()*+,;=~"


@final
class Origin(NamedTuple):
    """The scheme, host and port of a web address; two addresses of one origin have equal ones."""

    scheme: str
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        suffix = "" if self.port == _DEFAULT_PORTS[self.scheme] else f":{self.port}"
        return f"{self.scheme}://{host}{suffix}"


@final
class WebAddress(NamedTuple):
    """A web address: its origin, and the path with the query that is requested."""

    origin: Origin
    target: str


def parse_address(text: str) -> WebAddress:
    """Split a web address.

    Raises:
        ValueError: It is not an http or https address of a host, or it has a user or password.
    """
    parts = urlsplit(text)
    scheme = parts.scheme.lower()
    if scheme not in _DEFAULT_PORTS:
        raise ValueError("it is not an http or https address")
    if parts.username is not None or parts.password is not None:
        raise ValueError("it has a user name or password")
    host = (parts.hostname or "").encode("idna").decode() if parts.hostname else ""
    if not host or any(ord(character) <= 32 for character in host):
        raise ValueError("it has no host")
    port = _DEFAULT_PORTS[scheme] if parts.port is None else parts.port
    target = quote(parts.path or "/", safe=_PATH_CHARACTERS)
    if parts.query:
        target += "?" + quote(parts.query, safe=_PATH_CHARACTERS + "?")
    return WebAddress(Origin(scheme, host, port), target)


def parse_origin(text: str, option: str) -> Origin:
    """Return the origin of a setting such as ``https://cdn.example.com``.

    Raises:
        ConfigInvalid: It is not an origin.
    """
    try:
        return parse_address(text).origin
    except ValueError as error:
        raise ConfigInvalid(
            f"{text!r} is not an origin: {error}",
            where=option,
            hint="Write scheme and host: https://cdn.example.com.",
        ) from error

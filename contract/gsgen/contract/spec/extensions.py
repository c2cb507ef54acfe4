"""The registry of extensions: fields ``x-…`` of the manifest that have a published meaning."""

__all__ = ["REGISTERED", "Extension"]

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Extension:
    """A registered extension.

    Attributes:
        name: The field that holds its data, such as ``x-studio-relight``.
        owner: Who maintains its specification.
        page: Where its specification is published.
    """

    name: str
    owner: str
    page: str


# None is registered yet. An entry is added as docs/spec/extensions.md says.
REGISTERED: dict[str, Extension] = {}

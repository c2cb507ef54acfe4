"""Tells addresses of inputs from paths: ``https://``, ``hf://``, ``s3://`` and others."""

__all__ = ["address_of", "file_name", "folder_of", "is_plain_location"]

import os
import re
from pathlib import PurePosixPath, PureWindowsPath
from typing import Final
from urllib.parse import unquote

# Two letters or more: one is a drive of Windows. ``Path`` removes the second slash.
_ADDRESS_PATTERN: Final = re.compile(r"([a-z][a-z0-9+.-]+):(?=//|/[^/])/{1,3}", re.IGNORECASE)
_UNSAFE_CHARACTERS: Final = re.compile(r"[^A-Za-z0-9._-]+")
_MAX_NAME_LENGTH: Final = 120


def address_of(path: str | os.PathLike[str]) -> str:
    """Return the address that a text or path stands for; empty for the path of a file.

    ``Path("https://a/b")`` is ``https:/a/b``, which counts as the address, too.
    """
    text = os.fspath(path)
    match = _ADDRESS_PATTERN.match(text)
    if match is None or os.path.lexists(text):
        return ""
    scheme = match[1].lower()
    return f"{scheme}:{'///' if scheme == 'file' else '//'}{text[match.end() :]}"


def file_name(address: str) -> str:
    """Return a name for a copy of a file: that in its address, of letters that every system has."""
    path = _without_query(address).partition("://")[2].partition("/")[2]
    name = unquote(path).rstrip("/").rpartition("/")[2]
    safe_name = _UNSAFE_CHARACTERS.sub("_", name).lstrip(".")[-_MAX_NAME_LENGTH:]
    return safe_name or "file"


def folder_of(address: str) -> str:
    """Return the address of the folder of a file, with a slash at its end and without a query."""
    return _without_query(address).rpartition("/")[0] + "/"


def _without_query(address: str) -> str:
    return address.partition("?")[0].partition("#")[0]


def is_plain_location(location: str) -> bool:
    """Return whether the path of a file beside another one leads to it or below its folder."""
    path, windows_path = PurePosixPath(location), PureWindowsPath(location)
    has_folders_only = not {"..", "."} & {*path.parts, *windows_path.parts}
    is_relative = not (path.is_absolute() or windows_path.anchor)
    return bool(location) and location.isprintable() and is_relative and has_folders_only

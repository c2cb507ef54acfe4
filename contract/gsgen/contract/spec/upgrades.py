"""Upgrades manifests of other contract versions to the current one, by one function per version."""

__all__ = ["CONTRACT_VERSION", "CURRENT_VERSION", "UPGRADE_BY_VERSION", "Version", "upgrade"]

from collections.abc import Callable
from typing import Any

Version = tuple[int, int]

CURRENT_VERSION: Version = (1, 0)
CONTRACT_VERSION = f"{CURRENT_VERSION[0]}.{CURRENT_VERSION[1]}"


def released(document: dict[str, Any]) -> dict[str, Any]:
    """Convert a manifest of a development build to 1.0, which has all fields of such builds."""
    return document | {"contract": "1.0"}


# Development builds wrote the version 1.1, then 1.2. Rule GM018 tells the user.
UPGRADE_BY_VERSION: dict[Version, Callable[[dict[str, Any]], dict[str, Any]]] = {
    (1, 1): released,
    (1, 2): released,
}


def upgrade(document: dict[str, Any], version: Version) -> dict[str, Any]:
    """Return a manifest document of ``version`` as one of the current contract version.

    The document given is not changed. Where no upgrade starts at a version, it stays there.
    """
    while version in UPGRADE_BY_VERSION:
        document = UPGRADE_BY_VERSION[version](document)
        major, minor = document["contract"].split(".")
        version = (int(major), int(minor))
    return document

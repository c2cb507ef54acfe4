"""Upgrades manifests of older contract versions, by one function per minor version."""

__all__ = [
    "CURRENT",
    "UPGRADES",
    "Step",
    "Version",
    "upgrade",
    "upgrade_1_0_to_1_1",
    "upgrade_1_1_to_1_2",
]

from collections.abc import Callable, Mapping
from typing import Any

Version = tuple[int, int]
Step = Callable[[dict[str, Any]], dict[str, Any]]

CURRENT: Version = (1, 2)


def upgrade_1_0_to_1_1(document: dict[str, Any]) -> dict[str, Any]:
    """Convert a manifest of contract 1.0 to 1.1, where weighted sums become blending by depth.

    1.0 had no field that describes cells, so a reader could only blend by sorting. The upgraded
    manifest says so: ``alpha``. Rule GM018 tells the user.
    """
    lifted = document | {"contract": "1.1"}
    if lifted.get("kind") == "gaussian-generator" and lifted.get("blend") == "wsr":
        lifted["blend"] = "alpha"
    return lifted


def upgrade_1_1_to_1_2(document: dict[str, Any]) -> dict[str, Any]:
    """Convert a manifest of contract 1.1 to 1.2, which only adds fields."""
    return document | {"contract": "1.2"}


# From version → the function that lifts a manifest to the next one.
UPGRADES: dict[Version, Step] = {(1, 0): upgrade_1_0_to_1_1, (1, 1): upgrade_1_1_to_1_2}


def upgrade(
    document: dict[str, Any], version: Version, steps: Mapping[Version, Step] = UPGRADES
) -> dict[str, Any]:
    """Upgrade a manifest document version by version to the current contract version.

    The document given is not changed. Where no step starts at a version, it stays there.
    """
    while version in steps:
        document = steps[version](dict(document))
        major, minor = document["contract"].split(".")
        reached = (int(major), int(minor))
        if reached <= version:
            raise ValueError(
                f"the manifest upgrade from {version} led to {reached}, expected a newer version"
            )
        version = reached
    return document

"""Older manifests are carried forward by pure functions, one for each minor step."""

__all__ = ["CURRENT", "UPGRADES", "Step", "Version", "upgrade"]

from collections.abc import Callable, Mapping
from typing import Any

Version = tuple[int, int]
Step = Callable[[dict[str, Any]], dict[str, Any]]

CURRENT: Version = (1, 0)

# From version → the function that lifts a manifest to the next one, for example
# {(1, 0): upgrade_1_0_to_1_1}. Empty while 1.0 is the only version.
UPGRADES: dict[Version, Step] = {}


def upgrade(
    document: dict[str, Any], version: Version, steps: Mapping[Version, Step] = UPGRADES
) -> dict[str, Any]:
    """Return ``document`` lifted step by step as far as ``steps`` reach.

    The document given is not changed. Where no step starts at a version, it stays there.
    """
    while version in steps:
        document = steps[version](dict(document))
        major, minor = document["contract"].split(".")
        reached = (int(major), int(minor))
        if reached <= version:
            raise ValueError(f"the upgrade from {version} led to {reached}")
        version = reached
    return document

"""Entry points of all installed Python packages, read once per process."""

__all__ = ["registered_entry_points"]

from functools import cache
from importlib.metadata import EntryPoint, entry_points


@cache
def _all() -> tuple[EntryPoint, ...]:
    groups = entry_points()  # reads a file of every installed distribution
    return tuple(point for group in groups.groups for point in groups.select(group=group))


def registered_entry_points(group: str) -> list[EntryPoint]:
    """Return the installed entry points of ``group``, sorted by name."""
    points = [point for point in _all() if point.group == group]
    return sorted(points, key=lambda point: point.name)

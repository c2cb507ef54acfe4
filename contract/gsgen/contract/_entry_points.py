"""What other packages register with us: entry points, read once a process."""

__all__ = ["registered"]

from functools import cache
from importlib.metadata import EntryPoint, entry_points


@cache
def _all() -> tuple[EntryPoint, ...]:
    groups = entry_points()  # reads a file of every installed distribution
    return tuple(point for group in groups.groups for point in groups.select(group=group))


def registered(group: str) -> list[EntryPoint]:
    """Return the entry points of ``group``, by name."""
    found = [point for point in _all() if point.group == group]
    return sorted(found, key=lambda point: point.name)

"""Merges splats with the package that is installed for it, such as gsgen's tiles."""

__all__ = ["decimated"]

from collections.abc import Callable

from gsgen.contract._entry_points import registered_entry_points
from gsgen.formats.shared.errors import NotSupported
from gsgen.formats.shared.splats import Splats

Decimator = Callable[[Splats, int], Splats]


def decimated(splats: Splats, count: int) -> Splats:
    """Merge ``splats`` into at most ``count`` splats with a similar rendered image.

    Raises:
        NotSupported: No installed package merges splats.
    """
    for point in registered_entry_points("gsgen.decimators"):
        decimator: Decimator = point.load()
        return decimator(splats, count)
    raise NotSupported(
        "no package that merges splats is installed",
        where="decimate",
        hint="pip install 'gsgen[tiles]'",
    )

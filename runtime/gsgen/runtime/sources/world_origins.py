"""Places generators of one world beside each other, by the origins that their manifests declare."""

__all__ = ["align_world_origins"]

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.manifest import Space
from gsgen.runtime.sources.placed_source import PlacedSource
from gsgen.runtime.sources.source import Source


def align_world_origins(sources: Sequence[Source]) -> list[Source]:
    """Move the sources of Gaussians that declare a world origin into the local space of the first.

    Cameras, files and models without an origin are in that space, too. Offsets are computed in
    float64: origins may be millions of units, and differ by a few.
    """
    world_spaces = [source.space for source in sources if source.space and source.space.origin]
    placed: list[Source] = []
    for source in sources:
        space = source.space
        if space is None or space.origin is None or space is world_spaces[0]:
            placed.append(source)
            continue
        transform = _space_transform(space, world_spaces[0])
        is_same_origin = np.array_equal(transform, np.eye(4))
        placed.append(source if is_same_origin else PlacedSource(source, transform))
    return placed


def _space_transform(space: Space, first: Space) -> Float64[np.ndarray, "4 4"]:
    """Return the transform from one local space to another, given the world origins of both."""
    assert space.origin is not None
    assert first.origin is not None
    scale = 1.0
    if space.metres_per_unit and first.metres_per_unit:
        scale = space.metres_per_unit / first.metres_per_unit
    transform = np.diag([scale, scale, scale, 1.0])
    transform[:3, 3] = scale * np.array(space.origin) - np.array(first.origin)
    return transform

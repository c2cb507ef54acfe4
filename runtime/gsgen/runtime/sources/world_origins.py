"""Places generators of one world beside each other, by the origins that their manifests declare."""

__all__ = ["align_world_origins"]

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from gsgen.contract.spec.manifest import Space
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.runtime.sources.placed_source import PlacedSource
from gsgen.runtime.sources.source import Source


def align_world_origins(sources: Sequence[Source]) -> list[Source]:
    """Place generators that declare a world origin beside each other and beside the other files.

    Files with far coordinates are in the world, and so are cameras then: generators move to their
    world origins. Without such files, generators move into the local space of the first, where
    cameras, files and models without an origin are, too. Offsets are computed in float64: origins
    may be millions of units, and differ by a few.
    """
    world_spaces = [source.space for source in sources if source.space and source.space.origin]
    if any(_is_far(source) for source in sources):
        world_spaces.insert(0, Space(origin=NO_ORIGIN))
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


def _is_far(source: Source) -> bool:
    """Return whether a file has coordinates so far from 0 that they need an origin."""
    return any(source.data.origin) or any(any(mesh.data.origin) for mesh in source.meshes)


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

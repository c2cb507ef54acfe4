"""Splats with float32 positions relative to a float64 origin, for scenes on the globe."""

__all__ = ["PlacedSplats", "join_placed", "place"]

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float64

from gsgen.formats.glb.nodes import transform_splats
from gsgen.formats.shared.origins import join_splats
from gsgen.formats.shared.splats import Splats


@final
@dataclass(frozen=True, slots=True, eq=False)
class PlacedSplats:
    """Splats with positions relative to a float64 origin."""

    splats: Splats
    origin: Float64[np.ndarray, " 3"]

    def __len__(self) -> int:
        return len(self.splats)

    def positions(self) -> Float64[np.ndarray, "n 3"]:
        """The centres of the splats in the parent frame, in float64."""
        return np.asarray(self.splats.position.astype(np.float64) + self.origin)

    def relative_to_origin(self, origin: Float64[np.ndarray, " 3"]) -> Splats:
        """Return the splats relative to another origin, with positions rounded to float32 there."""
        position = (self.positions() - origin).astype(np.float32)
        x, y, z = (float(value) for value in origin)
        return replace(self.splats, position=position, origin=(x, y, z))


def place(splats: Splats, matrix: Float64[np.ndarray, "4 4"]) -> PlacedSplats:
    """Transform splats by a 4×4 matrix, whose translation stays in float64.

    Positions far from the file's own origin keep their digits: the middle of the splats becomes
    the origin.
    """
    low, high = splats.position.min(axis=0), splats.position.max(axis=0)
    middle = (low.astype(np.float64) + high) / 2
    near = replace(splats, position=(splats.position - middle).astype(np.float32))
    linear = np.eye(4)
    linear[:3, :3] = matrix[:3, :3]
    origin = matrix[:3, :3] @ middle + matrix[:3, 3]
    return PlacedSplats(transform_splats(near, linear), origin)


def join_placed(parts: Sequence[PlacedSplats], origin: Float64[np.ndarray, " 3"]) -> Splats:
    """Join sets of splats with float64 origins into one set with one origin."""
    return join_splats([part.relative_to_origin(origin) for part in parts])

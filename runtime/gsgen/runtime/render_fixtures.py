"""Example models that break a rule of level ``render``, and show nothing wrong before."""

__all__ = ["render_fixtures"]

import sys

import numpy as np

from gsgen.conformance.fixtures import Fixture
from gsgen.conformance.fixtures.arrays import f32
from gsgen.conformance.fixtures.clouds import still
from gsgen.conformance.fixtures.fixture import breaks, fixtures_in
from gsgen.conformance.fixtures.moving import drifting
from gsgen.conformance.fixtures.sketch import Sketch
from gsgen.contract.finding import Level
from gsgen.contract.layout import COVARIANCE


def render_fixtures() -> list[Fixture]:
    """Return the models, one a rule."""
    return fixtures_in(sys.modules[__name__])


@breaks("GB018", level=Level.RENDER)
def too_fine_to_be_seen() -> Sketch:
    """Gaussians a thousandth of a pixel wide, of whose opacity antialiasing leaves nothing."""
    fine = still()
    rows = np.array(fine.weights["rows"])
    rows[:, COVARIANCE] *= 1e-9
    return fine.weighing(rows=rows).declaring(antialias="mip")


@breaks("GB019", level=Level.RENDER)
def grows_out_of_nothing() -> Sketch:
    """At time zero Gaussians are too fine to be seen; they grow with time."""
    growing = drifting().reworded(
        "gaussians = Concat <axis = 1> (moved, opacity, spread)",
        "size = Max (time, least) wide = Mul (spread, size) "
        "gaussians = Concat <axis = 1> (moved, opacity, wide)",
    )
    return growing.weighing(least=f32(1e-9)).declaring(antialias="mip")

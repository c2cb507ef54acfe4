"""Example models that break Acme's rules."""

from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.fixture import breaks
from gsgen.conformance.fixtures.builders.sketch import Sketch


@breaks("acme/AC001", target="acme")
def five_in_a_cloud() -> Sketch:
    """Two Gaussians more than Acme's viewer draws."""
    return still(5)

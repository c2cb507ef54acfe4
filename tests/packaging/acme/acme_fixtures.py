"""Example models that break Acme's rules."""

from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.fixture import invalid
from gsgen.conformance.fixtures.builders.sketch import ModelSpec


@invalid("acme/AC001", target="acme")
def five_in_a_cloud() -> ModelSpec:
    """Two Gaussians more than Acme's viewer draws."""
    return still(5)

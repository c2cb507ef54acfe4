"""Which generators, written as authors of methods write them, do we export?

``MODULES`` are exported with parity and captured; ``REFUSED`` name the line and say what to write.
"""

__all__ = ["MODULES", "REFUSED", "Cloud", "Refusal"]

from sdk.exporting.authored import fields, networks, numerics, rigs, selection
from sdk.exporting.authored.cloud import Cloud
from sdk.exporting.authored.refused import REFUSED, Refusal

MODULES: tuple[type[Cloud], ...] = (
    *fields.MODULES,
    *networks.MODULES,
    *numerics.MODULES,
    *rigs.MODULES,
    *selection.MODULES,
)

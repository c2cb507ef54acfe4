"""Which generators, written as authors of methods write them, do we export?

``MODULES`` are exported with parity and captured; ``REFUSED`` name the line and say what to write.
"""

__all__ = ["MODULES", "REFUSED", "Cloud", "Refusal"]

from support.models.authored import fields, networks, numerics, rigs, selection
from support.models.authored.cloud import Cloud
from support.models.authored.refused import REFUSED, Refusal

MODULES: tuple[type[Cloud], ...] = (
    *fields.MODULES,
    *networks.MODULES,
    *numerics.MODULES,
    *rigs.MODULES,
    *selection.MODULES,
)

"""How do authors write ``forward``, and which of it is exported?

``EXPORTED`` is exported with parity and can be captured; ``REFUSED`` names the line and a change
that was tried.
"""

__all__ = ["EXPORTED", "REFUSED", "Refusal", "Scene"]

from sdk.exporting.idioms import constants, inputs_reach
from sdk.exporting.idioms.refused import REFUSED, Refusal
from sdk.exporting.idioms.scene import Scene

EXPORTED = (*constants.EXPORTED, *inputs_reach.EXPORTED)

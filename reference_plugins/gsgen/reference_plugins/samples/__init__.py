"""Which files does `gsgen samples` write, for guides and first experiments?

A garden of splats, cameras around it, a sunflower that takes a time and a pose, and its motion.
Nothing is downloaded, and no torch is needed.
"""

from gsgen.reference_plugins.samples.files import write_samples
from gsgen.reference_plugins.samples.garden import garden

__all__ = ["garden", "write_samples"]

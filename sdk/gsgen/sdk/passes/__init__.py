"""Graph rewrites, one a file: each says why it is needed, and keeps what the graph computes."""

__all__ = ["EndOutputsOnCompute", "MultiplyMatrices"]

from gsgen.sdk.passes.end_outputs_on_compute import EndOutputsOnCompute
from gsgen.sdk.passes.multiply_matrices import MultiplyMatrices

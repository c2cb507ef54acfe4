"""Which graph rewrites and output repairs exist?"""

__all__ = [
    "CastCount", "EndOutputsOnCompute", "MultiplyMatrices", "PadColor", "PinDimensions",
    "RenameOutputs", "ReorderHarmonics", "RoundByFloor", "SilencePadding",
]  # fmt: skip

from gsgen.sdk.passes.lowering.multiply_matrices import MultiplyMatrices
from gsgen.sdk.passes.lowering.round_by_floor import RoundByFloor
from gsgen.sdk.passes.portability.end_outputs_on_compute import EndOutputsOnCompute
from gsgen.sdk.passes.repairs import (
    CastCount,
    PadColor,
    PinDimensions,
    RenameOutputs,
    ReorderHarmonics,
    SilencePadding,
)

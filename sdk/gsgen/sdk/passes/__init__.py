"""Which graph rewrites and output repairs exist?"""

__all__ = [
    "CastCountOutput",
    "EndOutputsOnCompute",
    "LowerRoundToFloor",
    "MultiplyMatrices",
    "PadColor",
    "PinDimensions",
    "RenameOutputs",
    "ReorderHarmonics",
    "SilencePadding",
]  # fmt: skip

from gsgen.sdk.passes.lowering.multiply_matrices import MultiplyMatrices
from gsgen.sdk.passes.lowering.round_by_floor import LowerRoundToFloor
from gsgen.sdk.passes.portability.end_outputs_on_compute import EndOutputsOnCompute
from gsgen.sdk.passes.repairs import (
    CastCountOutput,
    PadColor,
    PinDimensions,
    RenameOutputs,
    ReorderHarmonics,
    SilencePadding,
)

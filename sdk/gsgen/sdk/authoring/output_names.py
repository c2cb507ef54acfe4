"""The names of an exported model's ONNX outputs."""

__all__ = [
    "APPEARANCE_RGB",
    "APPEARANCE_SH",
    "CELLS_OUTPUT",
    "COUNT_OUTPUT",
    "GAUSSIANS",
    "output_names",
]

from gsgen.contract.spec.manifest import GeneratorManifest

# Every known consumer binds these names correctly; the Visionary viewer searches for names that
# start with `gauss` or contain `color`.
GAUSSIANS = "gaussians"
APPEARANCE_SH = "color_sh"
APPEARANCE_RGB = "color_rgb"
COUNT_OUTPUT = "num_points"
CELLS_OUTPUT = "cells"


def output_names(manifest: GeneratorManifest) -> tuple[str, ...]:
    """Return the ONNX output names of an exported model, in graph order."""
    appearance = manifest.outputs.appearance
    assert appearance is not None
    names = (GAUSSIANS, appearance.name, COUNT_OUTPUT)
    return names if manifest.outputs.cells is None else (*names, CELLS_OUTPUT)

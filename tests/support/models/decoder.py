"""A generator that decodes Gaussians from features in every frame, as neural methods do."""

__all__ = ["write_decoder"]

from pathlib import Path
from typing import Final

import numpy as np

from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Input,
    Space,
)
from support.models.small_models import model, save, weight

_FEATURES: Final = 32
_HIDDEN: Final = 32

# Features and time go through two layers to all columns.
_TEXT: Final = """
decoder (float[1] time) => (float[{count},10] gaussians, float[{count},3] color) {{
    shift = Mul (time, phase)
    moved = Add (features, shift)
    hidden = MatMul (moved, first)
    active = Relu (hidden)
    made = MatMul (active, second)
    bounded = Sigmoid (made)
    gaussians, color = Split <axis = 1> (bounded, columns)
}}
"""


def write_decoder(path: Path, count: int) -> Path:
    """Write a model that decodes ``count`` Gaussians from random weights."""
    rng = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, np.float32)

    weights = {
        "features": normal(count, _FEATURES),
        "phase": normal(_FEATURES),
        "first": normal(_FEATURES, _HIDDEN),
        "second": normal(_HIDDEN, 13),
        "columns": np.array([10, 3], np.int64),
    }
    proto = model(
        _TEXT.format(count=count), *(weight(name, array) for name, array in weights.items())
    )
    outputs = GeneratorOutputs(
        GaussiansOutput("gaussians", count), AppearanceOutput("color", "rgb")
    )
    inputs = (Input(name="time", role="time", range=(0.0, 1.0), default=0.0),)
    manifest = GeneratorManifest(name="decoder", inputs=inputs, outputs=outputs, space=Space())
    return save(path, proto, manifest)

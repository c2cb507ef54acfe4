"""Public names of the packed layout: rows, cells, covariances, SH bases and matrices."""

__all__ = [
    "APPEARANCE_CHANNELS",
    "CELL_FIELDS",
    "COVARIANCE",
    "CULL_OPACITY",
    "FIELDS",
    "ITEMSIZE",
    "MOSTLY_INVISIBLE",
    "OPACITY",
    "POSITION",
    "ROW",
    "UPPER_TRIANGLE",
    "VISIBILITY",
    "WORD_BYTES",
    "Cells",
    "DecodedGaussians",
    "appearance_channels",
    "as_tensor",
    "basis",
    "coefficients",
    "covariance_upper",
    "decode",
    "decode_cells",
    "encode",
    "look_at",
    "perspective",
]

from gsgen.contract.probing.probes import as_tensor
from gsgen.contract.spec.geometry import covariance_upper, look_at, perspective
from gsgen.contract.spec.layout import (
    APPEARANCE_CHANNELS,
    CELL_FIELDS,
    COVARIANCE,
    CULL_OPACITY,
    FIELDS,
    ITEMSIZE,
    MOSTLY_INVISIBLE,
    OPACITY,
    POSITION,
    ROW,
    UPPER_TRIANGLE,
    VISIBILITY,
    WORD_BYTES,
    Cells,
    DecodedGaussians,
    appearance_channels,
    decode,
    decode_cells,
    encode,
)
from gsgen.contract.spec.spherical_harmonics import basis, coefficients

"""The packed layout: the columns of the tensors that represent Gaussians."""

__all__ = [
    "APPEARANCE_CHANNELS",
    "CELL_FIELDS",
    "COVARIANCE",
    "CULL_OPACITY",
    "FIELDS",
    "ITEMSIZE",
    "MOSTLY_INVISIBLE_SHARE",
    "OPACITY",
    "OPACITY_SLACK",
    "POSITION",
    "ROW_LENGTH",
    "UPPER_TRIANGLE",
    "VARIANCES",
    "VISIBILITY",
    "WORD_BYTES",
    "Cells",
    "DecodedGaussians",
    "appearance_channels",
    "decode",
    "decode_cells",
    "decode_rows",
    "encode",
]

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.errors import LayoutMismatch
from gsgen.contract.spec.spherical_harmonics import SH_COEFFICIENT_COUNTS, coefficients, degree_of

FIELDS = ("x", "y", "z", "opacity", "xx", "xy", "xz", "yy", "yz", "zz")
ROW_LENGTH = len(FIELDS)
POSITION = slice(0, 3)
OPACITY = 3
# Opacities may leave [0, 1] by this much.
OPACITY_SLACK = 1e-3
COVARIANCE = slice(4, 10)
_ROW_FIELDS = np.dtype([("position", "V12"), ("opacity", "V4"), ("covariance", "V24")])
# The columns of xx, yy and zz.
VARIANCES = [4, 7, 9]

# The (row, column) of each covariance entry of a row: xx xy xz yy yz zz.
UPPER_TRIANGLE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))

# A cell's row is a Gaussian's with its visibility where that has its opacity.
VISIBILITY = OPACITY
CELL_FIELDS = (*FIELDS[:VISIBILITY], "visibility", *FIELDS[VISIBILITY + 1 :])

# A Gaussian below this opacity cannot change an 8-bit pixel; the reference
# rasteriser of Kerbl et al. 2023 skips it.
CULL_OPACITY = 1 / 255

# A model is mostly invisible if more than this share of its rows is below that opacity.
MOSTLY_INVISIBLE_SHARE = 0.9

# Shaders read storage buffers in whole words of this many bytes.
WORD_BYTES = 4

# Bytes of an element, by the dtypes that outputs may have.
ITEMSIZE = {"float32": 4, "float16": 2}

# The channels an appearance row may have, by its declared space.
APPEARANCE_CHANNELS: dict[str, tuple[int, ...]] = {
    "sh": tuple(3 * count for count in SH_COEFFICIENT_COUNTS),
    "rgb": (3, 4),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedGaussians:
    """N unpacked Gaussians in the model's local space, as float32 arrays.

    Exactly one of ``sh`` and ``rgb`` is given.

    Attributes:
        position: Centres, [N, 3], in the unit that the manifest declares.
        opacity: Opacity after activation, [N], in [0, 1].
        covariance: Upper triangle xx xy xz yy yz zz of Σ, [N, 6].
        sh: Spherical harmonics, coefficient-major, [N, K, 3] with K = 1, 4, 9 or 16.
        rgb: Raw colour in [0, 1], [N, 3].
    """

    position: Float[np.ndarray, "n 3"]
    opacity: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n 6"]
    sh: Float[np.ndarray, "n k 3"] | None = None
    rgb: Float[np.ndarray, "n 3"] | None = None

    def __post_init__(self) -> None:
        n = len(self.position)
        expected: dict[str, tuple[int, ...]] = {"position": (n, 3), "opacity": (n,)}
        expected["covariance"] = (n, 6)
        if (self.sh is None) == (self.rgb is None):
            raise LayoutMismatch("give colours as exactly one of sh and rgb", where="Gaussians")
        if self.rgb is not None:
            expected["rgb"] = (n, 3)
        elif self.sh is not None:
            k = self.sh.shape[1] if self.sh.ndim == 3 else 0
            expected["sh"] = (n, k if k in SH_COEFFICIENT_COUNTS else SH_COEFFICIENT_COUNTS[-1], 3)
        for name, shape in expected.items():
            actual = getattr(self, name).shape
            if actual != shape:
                raise LayoutMismatch(
                    f"the shape is {list(actual)}, expected {list(shape)}",
                    where=f"Gaussians.{name}",
                )

    @property
    def degree(self) -> int | None:
        """The SH degree of the Gaussians' colours; None if the colours are raw RGB."""
        return None if self.sh is None else degree_of(self.sh.shape[1])

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, slots=True)
class Cells:
    """C unpacked cells (groups of Gaussians) for weighted blending, in local space.

    Attributes:
        position: Centres, [C, 3].
        visibility: How much is seen of their Gaussians, [C], in [0, 1].
        covariance: Upper triangle xx xy xz yy yz zz of the cell's ellipsoid, [C, 6].
    """

    position: Float[np.ndarray, "c 3"]
    visibility: Float[np.ndarray, " c"]
    covariance: Float[np.ndarray, "c 6"]

    def __len__(self) -> int:
        return len(self.position)


def appearance_channels(space: Literal["sh", "rgb"], degree: int | None, itemsize: int) -> int:
    """Return the number of channels of an appearance row for raw RGB or an SH degree.

    Three float16 colours fill a word and a half, so they are padded to four.
    """
    if space == "sh":
        return 3 * coefficients(degree or 0)
    return 3 if (3 * itemsize) % WORD_BYTES == 0 else 4


def encode(
    gaussians: DecodedGaussians, dtype: type[np.float32] | type[np.float16] = np.float32
) -> tuple[Float[np.ndarray, "n 10"], Float[np.ndarray, "n c"]]:
    """Pack Gaussians into tensors of ``dtype``: ``(gaussians [N, 10], appearance [N, C])``.

    SH rows are ``[k0R k0G k0B k1R …]``; a fourth channel that float16 RGB needs is 1.
    """
    columns = (gaussians.position, gaussians.opacity[:, None], gaussians.covariance)
    rows = np.concatenate(columns, axis=1).astype(dtype)
    n = len(gaussians)
    if gaussians.sh is not None:
        return rows, gaussians.sh.reshape(n, 3 * gaussians.sh.shape[1]).astype(dtype)
    channels = appearance_channels("rgb", None, np.dtype(dtype).itemsize)
    color = np.ones((n, channels), dtype)
    color[:, :3] = gaussians.rgb
    return rows, color


def decode(
    rows: Float[np.ndarray, "n 10"],
    appearance: Float[np.ndarray, "n c"],
    space: Literal["sh", "rgb"],
) -> DecodedGaussians:
    """Unpack packed Gaussians and their appearance to float32; the inverse of :func:`encode`.

    Raises:
        LayoutMismatch: The arrays are not [N, 10] and [N, C] with a C that ``space`` has.
    """
    if rows.ndim != 2 or rows.shape[1] != ROW_LENGTH:
        raise LayoutMismatch(
            f"the packed Gaussians have shape {list(rows.shape)}, expected [N, {ROW_LENGTH}]",
            where="gaussians",
        )
    allowed_channels = APPEARANCE_CHANNELS[space]
    if (
        appearance.ndim != 2
        or appearance.shape[1] not in allowed_channels
        or len(appearance) != len(rows)
    ):
        raise LayoutMismatch(
            f"the appearance has shape {list(appearance.shape)}, expected [{len(rows)}, C] with C in {allowed_channels}",
            where="appearance",
        )
    position, opacity, covariance = decode_rows(rows)
    color = appearance.astype(np.float32)
    n = len(rows)
    return DecodedGaussians(
        position=position,
        opacity=opacity,
        covariance=covariance,
        sh=color.reshape(n, color.shape[1] // 3, 3) if space == "sh" else None,
        rgb=color[:, :3] if space == "rgb" else None,
    )


def decode_rows(
    rows: Float[np.ndarray, "n 10"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, "n 6"]]:
    """Unpack rows to centres, opacities and covariances: contiguous float32 arrays."""
    # Elements of 12, 4 and 24 bytes are copied in half the time of slices of the columns.
    fields = np.ascontiguousarray(rows, np.float32).view(_ROW_FIELDS)
    position, opacity, covariance = (
        fields[name].copy().view(np.float32) for name in ("position", "opacity", "covariance")
    )
    return position.reshape(-1, 3), opacity.reshape(-1), covariance.reshape(-1, 6)


def decode_cells(rows: Float[np.ndarray, "c 10"]) -> Cells:
    """Unpack rows of the cells output (groups of Gaussians) to float32.

    Raises:
        LayoutMismatch: The array is not [C, 10].
    """
    if rows.ndim != 2 or rows.shape[1] != ROW_LENGTH:
        raise LayoutMismatch(
            f"the rows of cells (groups of Gaussians) have shape {list(rows.shape)}, "
            f"expected [C, {ROW_LENGTH}]",
            where="cells",
            hint="A row has a centre (3 numbers), a visibility (1) and a covariance (6).",
        )
    return Cells(*decode_rows(rows))

"""Splats in memory: what every reader returns and every writer takes."""

import math
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from jaxtyping import Float, Float32

from gsgen.formats.shared.errors import ValueInvalid

__all__ = ["SH_COUNTS", "PackedRows", "PointCloud", "Splats"]

SH_COUNTS = (1, 4, 9, 16, 25)
"""SH coefficients per channel for degree 0, 1, 2, 3 and 4."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """Gaussians as training leaves them: nothing activated, nothing normalised.

    Space is that of a 3DGS PLY file (x right, y down, z forward). The parameters and
    their activations are those of Kerbl et al. 2023, "3D Gaussian Splatting for
    Real-Time Radiance Field Rendering".

    Attributes:
        position: Centres, in scene units.
        rotation: Quaternions (w, x, y, z); to be normalised before use.
        log_scale: Natural logarithms of the standard deviations along the three axes.
        logit_opacity: Opacity before the sigmoid; +inf is opaque, -inf invisible.
        sh: Spherical harmonics, coefficient-major; colour = max(0, 0.5 + Σ Y_k sh_k).
        antialiased: Trained with the filter of Mip-Splatting (Yu et al. 2023), which takes
            opacity from what it widens; few formats say so.
        color_space: Of the colours; few formats say that they are linear.

    Raises:
        ValueInvalid: An array has another shape or data type.
    """

    position: Float32[np.ndarray, "n 3"]
    rotation: Float32[np.ndarray, "n 4"]
    log_scale: Float32[np.ndarray, "n 3"]
    logit_opacity: Float32[np.ndarray, " n"]
    sh: Float32[np.ndarray, "n k 3"]
    antialiased: bool = False
    color_space: Literal["srgb", "linear"] = "srgb"

    def __post_init__(self) -> None:
        _require("position", self.position, ("float32",), ("n", 3))
        rows = len(self.position)
        _require("rotation", self.rotation, ("float32",), (rows, 4))
        _require("log_scale", self.log_scale, ("float32",), (rows, 3))
        _require("logit_opacity", self.logit_opacity, ("float32",), (rows,))
        _require("sh", self.sh, ("float32",), (rows, "k", 3))
        if self.sh.shape[1] not in SH_COUNTS:
            raise ValueInvalid(
                f"{self.sh.shape[1]} SH coefficients",
                where="sh",
                expected="1, 4, 9, 16 or 25 of them (degree 0 to 4)",
            )

    def __len__(self) -> int:
        return len(self.position)

    @property
    def degree(self) -> int:
        """The SH degree: 0 for plain colour, at most 4."""
        return math.isqrt(self.sh.shape[1]) - 1


@final
@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Coloured points, such as structure from motion gives.

    Attributes:
        position: Points, in scene units.
        color: Red, green, blue in [0, 1], in the colour space of the file.

    Raises:
        ValueInvalid: An array has another shape or data type.
    """

    position: Float32[np.ndarray, "n 3"]
    color: Float32[np.ndarray, "n 3"]

    def __post_init__(self) -> None:
        _require("position", self.position, ("float32",), ("n", 3))
        _require("color", self.color, ("float32",), (len(self.position), 3))

    def __len__(self) -> int:
        return len(self.position)


@final
@dataclass(frozen=True, slots=True, eq=False)
class PackedRows:
    """One frame as a generator emits it: the two packed tensors of the contract.

    Values, and whether the two data types agree, are for the validator to judge.

    Attributes:
        gaussians: Rows ``x y z opacity xx xy xz yy yz zz``, float16 or float32.
        appearance: SH coefficients or raw colour of each row, float16 or float32.

    Raises:
        ValueInvalid: An array has another shape or data type.
    """

    gaussians: Float[np.ndarray, "n 10"]
    appearance: Float[np.ndarray, "n c"]

    def __post_init__(self) -> None:
        halves = ("float16", "float32")
        _require("gaussians", self.gaussians, halves, ("n", 10))
        _require("appearance", self.appearance, halves, (len(self.gaussians), "c"))

    def __len__(self) -> int:
        return len(self.gaussians)


def _require(
    name: str, array: object, dtypes: tuple[str, ...], shape: tuple[int | str, ...]
) -> None:
    """Raise ValueInvalid unless ``array`` fits; a name in ``shape`` is any size."""
    expected = f"{' or '.join(dtypes)} {_bracketed(shape)}"
    if not isinstance(array, np.ndarray):
        raise ValueInvalid(f"a {type(array).__name__}", where=name, expected=expected)
    sizes = zip(array.shape, shape, strict=False)
    fits = (
        array.ndim == len(shape)
        and array.dtype in [np.dtype(dtype) for dtype in dtypes]
        and all(seen == size or isinstance(size, str) for seen, size in sizes)
    )
    if not fits:
        seen = f"{array.dtype} {_bracketed(array.shape)}"
        raise ValueInvalid(seen, where=name, expected=expected)


def _bracketed(shape: tuple[int | str, ...]) -> str:
    return "[" + ", ".join(map(str, shape)) + "]"

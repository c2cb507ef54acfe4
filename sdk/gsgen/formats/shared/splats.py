"""The data classes of splats, points and packed Gaussians that readers and writers share."""

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, final

import numpy as np
from jaxtyping import Float, Float32

from gsgen.contract._notebook import preview_png, summary_html
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.quantities import SH_C0, sigmoid, unit_or_zero

__all__ = [
    "DEFAULT_UP", "NO_ORIGIN", "SH_COUNTS", "PackedRows", "PointCloud", "Splats", "save_splats_with",
]  # fmt: skip

SH_COUNTS = (1, 4, 9, 16, 25)
"""SH coefficients per channel for degree 0, 1, 2, 3 and 4."""
DEFAULT_UP: Final = (0.0, -1.0, 0.0)
"""The upward direction of splats whose file declares none."""
NO_ORIGIN: Final = (0.0, 0.0, 0.0)
"""The origin of splats whose positions are those of the file."""
MAX_FLOAT32_OFFSET: Final = 16384.0
"""The largest coordinate without an origin: beyond it, float32 has steps of over 1/1000."""

SPLAT_ARRAY_NAMES: Final = ("position", "rotation", "log_scale", "logit_opacity", "sh")
"""Names of the arrays of :class:`Splats`."""


def _no_writer(path: str | os.PathLike[str], splats: "Splats") -> None:
    raise NotImplementedError("import gsgen.formats, which has the writers of all formats")


_write: Callable[[str | os.PathLike[str], "Splats"], None] = _no_writer


def save_splats_with(write: Callable[[str | os.PathLike[str], "Splats"], None]) -> None:
    """Set the function that :meth:`Splats.save` calls; the table of formats, above, sets it."""
    global _write
    _write = write


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Splats:
    """Gaussian splats as 3DGS training stores them: before activation and normalisation.

    Coordinates are those of a 3DGS PLY file (x right, y down, z forward). The parameters and
    their activations are those of Kerbl et al. 2023, "3D Gaussian Splatting for
    Real-Time Radiance Field Rendering".

    Attributes:
        position: The centres, in scene units.
        rotation: Quaternions (w, x, y, z), not normalised.
        log_scale: Natural logarithms of the standard deviations along the three axes.
        logit_opacity: Opacity before the sigmoid; +inf is opaque, -inf invisible.
        sh: Spherical harmonics, coefficient-major; colour = max(0, 0.5 + Σ Y_k sh_k).
        antialiased: Whether training used the filter of Mip-Splatting (Yu et al. 2023), which
            lowers the opacity of splats that it widens; few formats store this flag.
        color_space: The colour space of the colours; few formats store it.
        up: The upward direction, if the file declares one; else that of 3DGS training, -y.
        origin: The point of the file's world that positions are relative to.
        rounding: At most so far is a position from that of the file, in scene units.

    Raises:
        ValueInvalid: An array has a wrong shape or data type.
    """

    position: Float32[np.ndarray, "n 3"]
    rotation: Float32[np.ndarray, "n 4"]
    log_scale: Float32[np.ndarray, "n 3"]
    logit_opacity: Float32[np.ndarray, " n"]
    sh: Float32[np.ndarray, "n k 3"]
    antialiased: bool = False
    color_space: Literal["srgb", "linear"] = "srgb"
    up: tuple[float, float, float] = DEFAULT_UP
    origin: tuple[float, float, float] = NO_ORIGIN
    rounding: float = 0.0

    def __post_init__(self) -> None:
        _require_array("position", self.position, ("float32",), ("n", 3))
        rows = len(self.position)
        _require_array("rotation", self.rotation, ("float32",), (rows, 4))
        _require_array("log_scale", self.log_scale, ("float32",), (rows, 3))
        _require_array("logit_opacity", self.logit_opacity, ("float32",), (rows,))
        _require_array("sh", self.sh, ("float32",), (rows, "k", 3))
        if self.sh.shape[1] not in SH_COUNTS:
            raise ValueInvalid(
                f"the splats have {self.sh.shape[1]} SH coefficients",
                where="sh",
                expected="1, 4, 9, 16 or 25 (degree 0 to 4)",
            )

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, rows: "slice | np.ndarray | list[int]") -> "Splats":
        """Return the splats of some rows: a slice, a mask, or an array of indices."""
        arrays: dict[str, Any] = {name: getattr(self, name)[rows] for name in SPLAT_ARRAY_NAMES}
        return replace(self, **arrays)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the splats in the format of the path's suffix, such as .ply or .spz.

        Raises:
            FormatError: The format cannot store the splats, or no format has the suffix.
        """
        _write(path, self)

    @property
    def xyz(self) -> Float32[np.ndarray, "n 3"]:
        """The centres, in scene units."""
        return self.position

    @property
    def opacity(self) -> Float32[np.ndarray, " n"]:
        """The opacity of each splat, from 0 to 1: the sigmoid of ``logit_opacity``."""
        return sigmoid(self.logit_opacity)

    @property
    def scale(self) -> Float32[np.ndarray, "n 3"]:
        """The standard deviations along the three axes, in scene units."""
        return np.asarray(np.exp(self.log_scale))

    @property
    def quaternion(self) -> Float32[np.ndarray, "n 4"]:
        """The rotations as unit quaternions (w, x, y, z)."""
        return unit_or_zero(self.rotation)

    @property
    def rgb(self) -> Float32[np.ndarray, "n 3"]:
        """The colour of each splat from all sides, of harmonics of degree 0, from 0 to 1."""
        return np.clip(0.5 + SH_C0 * self.sh[:, 0], 0, 1).astype(np.float32)

    @property
    def degree(self) -> int:
        """The SH degree of the splats, from 0 (constant colour) to 4."""
        return math.isqrt(self.sh.shape[1]) - 1

    def _repr_html_(self) -> str:
        """Return a picture and the main facts of the splats as HTML, for notebooks."""
        rows = [
            ("SH degree", str(self.degree)),
            ("box", _box(self.position, self.origin)),
            ("training", self._training_mode_text),
        ]
        return summary_html(f"{len(self):,} splats", rows, preview_png(self))

    def __repr__(self) -> str:
        facts = f"SH degree {self.degree}, box {_box(self.position, self.origin)}, {self._training_mode_text}"
        return f"<Splats: {len(self):,} splats, {facts}>"

    @property
    def _training_mode_text(self) -> str:
        return "antialiased" if self.antialiased else "classic"


def _box(position: Float32[np.ndarray, "n 3"], origin: tuple[float, float, float]) -> str:
    if not len(position):
        return "empty"
    corners = f"{_corner_text(position.min(axis=0))} to {_corner_text(position.max(axis=0))}"
    return f"{corners} from {_corner_text(origin, digits=15)}" if any(origin) else corners


def _corner_text(point: Iterable[float], digits: int = 3) -> str:
    return f"({', '.join(f'{value:.{digits}g}' for value in point)})"


@final
@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Coloured points, such as structure from motion returns.

    Attributes:
        position: The points, in scene units.
        color: Red, green, blue in [0, 1], in the colour space of the file.
        origin: The point of the file's world that positions are relative to.
        rounding: At most so far is a position from that of the file, in scene units.

    Raises:
        ValueInvalid: An array has a wrong shape or data type.
    """

    position: Float32[np.ndarray, "n 3"]
    color: Float32[np.ndarray, "n 3"]
    origin: tuple[float, float, float] = NO_ORIGIN
    rounding: float = 0.0

    def __post_init__(self) -> None:
        _require_array("position", self.position, ("float32",), ("n", 3))
        _require_array("color", self.color, ("float32",), (len(self.position), 3))

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        return f"<PointCloud: {len(self):,} points, box {_box(self.position, self.origin)}>"


@final
@dataclass(frozen=True, slots=True, eq=False)
class PackedRows:
    """One frame of an ONNX generator: packed Gaussians and their appearance (colours).

    The validator checks the values, and that both data types agree.

    Attributes:
        gaussians: Rows ``x y z opacity xx xy xz yy yz zz``, float16 or float32.
        appearance: SH coefficients or raw colour of each row, float16 or float32.

    Raises:
        ValueInvalid: An array has a wrong shape or data type.
    """

    gaussians: Float[np.ndarray, "n 10"]
    appearance: Float[np.ndarray, "n c"]

    def __post_init__(self) -> None:
        float_dtypes = ("float16", "float32")
        _require_array("gaussians", self.gaussians, float_dtypes, ("n", 10))
        _require_array("appearance", self.appearance, float_dtypes, (len(self.gaussians), "c"))

    def __len__(self) -> int:
        return len(self.gaussians)

    def __repr__(self) -> str:
        channels = f"{self.appearance.shape[1]} channels of appearance"
        return f"<PackedRows: {len(self):,} Gaussians, {channels}, {self.gaussians.dtype}>"


def _require_array(
    name: str, array: object, dtypes: tuple[str, ...], shape: tuple[int | str, ...]
) -> None:
    """Raise ValueInvalid unless an array has the given dtype and shape; named sizes match any."""
    expected = f"{' or '.join(dtypes)} {_shape_text(shape)}"
    if not isinstance(array, np.ndarray):
        raise ValueInvalid(f"the value is a {type(array).__name__}", where=name, expected=expected)
    sizes = zip(array.shape, shape, strict=False)
    is_valid = (
        array.ndim == len(shape)
        and array.dtype in [np.dtype(dtype) for dtype in dtypes]
        and all(length == size or isinstance(size, str) for length, size in sizes)
    )
    if not is_valid:
        actual = f"the array is {array.dtype} {_shape_text(array.shape)}"
        raise ValueInvalid(actual, where=name, expected=expected)


def _shape_text(shape: tuple[int | str, ...]) -> str:
    return "[" + ", ".join(map(str, shape)) + "]"

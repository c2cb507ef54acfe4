"""Static scenes: a splat file or a coloured point cloud as an ONNX generator without inputs.

Splats are activated as in Kerbl et al. 2023, "3D Gaussian Splatting for Real-Time Radiance Field
Rendering": opacity by the sigmoid, scale by the exponential, covariance by equation 6. Bare
points get the initialisation of its published code: isotropic Gaussians whose variance is the
mean squared distance to the three nearest neighbours, at opacity 0.1.
"""

__all__ = ["INITIAL_OPACITY", "StaticScene", "from_content", "neighbour_scale"]

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.spherical_harmonics import (
    MAX_DEGREE,
    SH_COEFFICIENT_COUNTS,
    basis,
    coefficients,
)
from gsgen.formats import PackedRows, PointCloud, Splats
from gsgen.sdk.exporting.constant_generator import Axis, ConstantRows, ConstantSource
from gsgen.sdk.exporting.pipeline import Dtype
from gsgen.sdk.exporting.sh_degrees import REQUIRED_DEGREES, stored_degree

INITIAL_OPACITY = 0.1

# The published initialisation clamps squared distances here, so that duplicates have a size.
_SMALLEST_SQUARE = 1e-7
_NEIGHBOUR_COUNT = 3
_AXES: tuple[Axis, ...] = ("+x", "+y", "+z", "-x", "-y", "-z")
_MIN_AXIS_COSINE = 0.9999
_UP_DIRECTION = np.array([[0.0, -1.0, 0.0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticScene(ConstantSource):
    """The content of a splat file, and the options of its export."""

    family: ClassVar[str | None] = "static"

    content: Splats | PointCloud | PackedRows  # splats, points, or packed rows
    opacity: float = INITIAL_OPACITY  # opacity of bare points, in (0, 1]
    # whether packed rows with three channels hold SH or RGB; RGB if absent
    appearance: Literal["sh", "rgb"] | None = None
    sh_degree: int | None = None  # SH degree to cut or pad to; that of the file if absent
    # color space; that of the file if absent, or sRGB
    color_space: Literal["srgb", "linear"] | None = None
    # antialiasing of the training; that of the file if absent, or classic
    antialias: Literal["classic", "mip"] | None = None

    def pack(self, dtype: Dtype | None, target: str) -> ConstantRows:
        """Pack the Gaussians of a splat file for ONNX; ``target`` may require an SH degree."""
        sh_degree, content = self.sh_degree, self.content
        if sh_degree is None and isinstance(content, Splats):
            sh_degree = REQUIRED_DEGREES.get(target)
        packed = from_content(
            content,
            dtype=dtype,
            opacity=self.opacity,
            appearance=self.appearance,
            sh_degree=sh_degree,
        )
        return replace(
            packed,
            color_space=self.color_space or packed.color_space,
            antialias=self.antialias or packed.antialias,
        )


def from_content(
    content: Splats | PointCloud | PackedRows,
    *,
    dtype: Dtype | None = None,
    opacity: float = INITIAL_OPACITY,
    appearance: Literal["sh", "rgb"] | None = None,
    sh_degree: int | None = None,
) -> ConstantRows:
    """Convert splats, points or packed Gaussians of a file to constant outputs for an ONNX model.

    Packed rows pass through unchanged. ``dtype`` is float32, or that of packed rows, by default,
    and RGB is the default of ``appearance``. Points get SH if ``sh_degree`` is present, else RGB;
    in float16, degrees 0 and 2 are padded to the next.
    """
    if isinstance(content, PackedRows):
        return _constant_rows(content, dtype, appearance)
    if isinstance(content, Splats):
        return _rows_from_splats(content, dtype or "float32", sh_degree)
    return _rows_from_points(content, dtype or "float32", opacity, sh_degree)


def _rows_from_splats(splats: Splats, dtype: Dtype, sh_degree: int | None) -> ConstantRows:
    degree = min(splats.degree, MAX_DEGREE) if sh_degree is None else sh_degree
    notes: list[str] = []
    if splats.degree > degree:
        notes.append(f"SH degree {splats.degree} is cut to {degree}")
    degree, note = stored_degree(degree, half=dtype == "float16")
    up, up_note = _up_axis_of(splats.up)
    # exp(-(-inf)) is inf, and 1 / (1 + inf) is 0, the opacity that -inf stands for.
    with np.errstate(over="ignore"):
        opacity = 1 / (1 + np.exp(-splats.logit_opacity.astype(np.float64)))
    scale = np.exp(splats.log_scale.astype(np.float64))
    gaussians = layout.DecodedGaussians(
        position=splats.position,
        opacity=opacity,
        covariance=covariance_upper(scale, splats.rotation),
        sh=_resize_sh(splats.sh, degree),
    )
    rows, color = layout.encode(gaussians, np.dtype(dtype).type)
    return ConstantRows(
        rows=rows,
        appearance=color,
        space="sh",
        description=f"{len(splats):,} splats of SH degree {splats.degree}",
        color_space=splats.color_space,
        up=up,
        origin=splats.origin if any(splats.origin) else None,
        antialias="mip" if splats.antialiased else "classic",
        notes=tuple(filter(None, (*notes, note, up_note))),
    )


def _up_axis_of(up: tuple[float, float, float]) -> tuple[Axis, str]:
    """Return the axis nearest to an upward direction, and a note if they differ."""
    index = int(np.argmax(np.abs(up)))
    axis = _AXES[index + 3 * (up[index] < 0)]
    if abs(up[index]) > _MIN_AXIS_COSINE:
        return axis, ""
    numbers = ", ".join(f"{value:.3g}" for value in up)
    return axis, f"the upward direction ({numbers}) is declared as {axis}, the nearest axis"


def _resize_sh(sh: Float[np.ndarray, "n k 3"], degree: int) -> Float[np.ndarray, "n l 3"]:
    """Truncate SH coefficients to a degree, or pad them with zeros."""
    resized_sh = np.zeros((len(sh), coefficients(degree), 3), sh.dtype)
    shared_count = min(resized_sh.shape[1], sh.shape[1])
    resized_sh[:, :shared_count] = sh[:, :shared_count]
    return resized_sh


def _rows_from_points(
    points: PointCloud, dtype: Dtype, opacity: float, sh_degree: int | None
) -> ConstantRows:
    scale = neighbour_scale(points.position)
    n = len(points)
    covariance = np.zeros((n, 6))
    covariance[:, [0, 3, 5]] = (scale**2)[:, None]
    gaussians = layout.DecodedGaussians(
        position=points.position,
        opacity=np.full(n, opacity),
        covariance=covariance,
        rgb=points.color,
    )
    note = ""
    if sh_degree is not None:
        sh_degree, note = stored_degree(sh_degree, half=dtype == "float16")
        sh = _resize_sh(_constant_term(points.color), sh_degree)
        gaussians = replace(gaussians, rgb=None, sh=sh)
    rows, color = layout.encode(gaussians, np.dtype(dtype).type)
    return ConstantRows(
        rows=rows,
        appearance=color,
        space="rgb" if sh_degree is None else "sh",
        description=f"{n:,} coloured points",
        origin=points.origin if any(points.origin) else None,
        notes=(note,) if note else (),
    )


def _constant_term(color: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 1 3"]:
    """Convert colours to SH coefficients of degree 0: 0.5 + Y₀ c₀ = colour."""
    return np.asarray(
        (np.asarray(color, np.float64)[:, None] - 0.5) / basis(_UP_DIRECTION, 0)[0, 0]
    )


def _constant_rows(
    packed: PackedRows, dtype: Dtype | None, appearance: Literal["sh", "rgb"] | None
) -> ConstantRows:
    rows, color = packed.gaussians, packed.appearance
    channels = color.shape[1]
    sh_channels = [3 * count for count in SH_COEFFICIENT_COUNTS]
    space = appearance or ("rgb" if channels in (3, 4) else "sh")
    if channels not in (sh_channels if space == "sh" else (3, 4)):
        expected = f"{sh_channels} for SH or 3 or 4 for RGB"
        raise GsgenError(f"has {channels} channels, expected {expected}", where="appearance")
    if dtype is not None:
        rows, color = rows.astype(dtype), color.astype(dtype)
    return ConstantRows(
        rows=rows,
        appearance=color,
        space=space,
        description=f"{len(packed):,} packed rows",
        passes_through=True,
    )


def neighbour_scale(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the root mean square distance of each point to its three nearest neighbours."""
    try:
        from scipy.spatial import KDTree
    except ImportError as error:
        message = "sizes of bare points need scipy, which is not installed"
        hint = "pip install 'gsgen[sdk]'"
        raise GsgenError(message, hint=hint) from error
    positions = np.asarray(points, np.float64)
    k = min(_NEIGHBOUR_COUNT, len(positions) - 1)
    if k < 1:
        return np.full(len(positions), np.sqrt(_SMALLEST_SQUARE))
    distances, _ = KDTree(positions).query(positions, k=k + 1, workers=-1)
    mean_squared_distances = np.square(distances[:, 1:]).mean(axis=1)
    return np.asarray(np.sqrt(np.maximum(mean_squared_distances, _SMALLEST_SQUARE)))

"""Gaussians in packed rows of ten numbers, whose values may change between frames."""

__all__ = ["SplatData"]

from typing import Literal, final

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE, coefficients, degree_of
from gsgen.formats import PackedRows, PointCloud, Splats
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.runtime.errors import SceneInvalid

_APPEARANCE_DTYPES = (np.dtype(np.float16), np.dtype(np.float32))


@final
class SplatData:
    """Packed Gaussians and their colours, as an ONNX generator outputs them.

    Attributes:
        rows: ``x y z opacity xx xy xz yy yz zz``, [N, 10], float32 or float16.
        appearance: SH coefficients or RGB, [N, C], float32 or float16.
        space: What ``appearance`` holds.
        count: Number of live rows: only the first ``count`` are drawn.
        rows_version: Grows when the rows change; holders of a copy compare it.
        appearance_version: Grows when the appearance changes.
        cells: Cells of weighted sums, [C, 10]: rows like those of Gaussians, with a visibility in
            place of the opacity; None without cells.
        per_cell: Gaussians per cell: row r belongs to cell r // per_cell.
        cells_version: Grows when the cells change.
        antialias: The default of the sets that draw it: ``mip`` if training used the filter of
            Mip-Splatting (Yu et al. 2023).
        color_space: The default of the scenes that draw it.
        origin: The point of the local space that the positions of rows and cells are relative to,
            for coordinates of millions, which float32 would round.
    """

    def __init__(
        self,
        rows: Float[np.ndarray, "n 10"],
        appearance: Float[np.ndarray, "n c"],
        space: Literal["sh", "rgb"],
        *,
        count: int | None = None,
        cells: Float[np.ndarray, "c 10"] | None = None,
        per_cell: int = 1,
        antialias: Literal["classic", "mip"] = "classic",
        color_space: Literal["srgb", "linear"] = "srgb",
        origin: tuple[float, float, float] = NO_ORIGIN,
    ) -> None:
        self.origin = origin
        self.antialias: Literal["classic", "mip"] = antialias
        self.color_space: Literal["srgb", "linear"] = color_space
        self.space: Literal["sh", "rgb"] = space
        self.rows_version = self.appearance_version = self.cells_version = 0
        self.rows, self.appearance, self.count = _validate_rows(rows, appearance, space, count)
        self.per_cell = per_cell
        self.cells = None if cells is None else _validate_cells(cells, per_cell, len(rows))

    @classmethod
    def from_splats(cls, splats: Splats) -> "SplatData":
        """Convert the parameters of a splat file to packed rows; drops SH above degree 3.

        Opacity by the sigmoid, scale by the exponential, covariance by equation 6 of Kerbl
        et al. 2023.
        """
        with np.errstate(over="ignore"):  # the sigmoid of -inf is the 0 that it means
            opacity = 1 / (1 + np.exp(-splats.logit_opacity.astype(np.float64)))
        scale = np.exp(splats.log_scale.astype(np.float64))
        gaussians = layout.DecodedGaussians(
            position=splats.position,
            opacity=opacity,
            covariance=covariance_upper(scale, splats.rotation),
            sh=splats.sh[:, : coefficients(MAX_DEGREE)],
        )
        return cls(
            *layout.encode(gaussians),
            "sh",
            antialias="mip" if splats.antialiased else "classic",
            color_space=splats.color_space,
            origin=splats.origin,
        )

    @classmethod
    def from_packed(
        cls, packed: PackedRows, space: Literal["sh", "rgb"] | None = None
    ) -> "SplatData":
        """Create splat data from packed rows, without conversion.

        Args:
            packed: The rows.
            space: Kind of the appearance; if None, three or four channels mean RGB.
        """
        is_rgb_appearance = packed.appearance.shape[1] in (3, 4)
        return cls(
            packed.gaussians, packed.appearance, space or ("rgb" if is_rgb_appearance else "sh")
        )

    @classmethod
    def from_points(cls, points: PointCloud, opacity: float = 0.8) -> "SplatData":
        """Convert a point cloud to round Gaussians, sized by the distance to three neighbours.

        A ball is at most four times the median size: isolated points would hide the others.

        Raises:
            SceneInvalid: SciPy is not installed.
        """
        spacing = _point_spacing(points.position)
        variance = (0.5 * np.minimum(spacing, 4 * np.median(spacing))) ** 2
        rows = np.zeros((len(points), layout.ROW_LENGTH), np.float32)
        rows[:, layout.POSITION] = points.position
        rows[:, layout.OPACITY] = opacity
        rows[:, layout.COVARIANCE] = variance[:, None] * [1, 0, 0, 1, 0, 1]
        return cls(rows, points.color, "rgb", origin=points.origin)

    def update(
        self,
        rows: Float[np.ndarray, "n 10"] | None = None,
        appearance: Float[np.ndarray, "n c"] | None = None,
        count: int | None = None,
        cells: Float[np.ndarray, "c 10"] | None = None,
        origin: tuple[float, float, float] | None = None,
    ) -> None:
        """Replace packed Gaussians, colours or groups of Gaussians; shapes and dtypes stay equal.

        Arrays, and the origin, that are None stay as they are; ``count`` rows are live, or all if it is None.

        Raises:
            SceneInvalid: A shape or a dtype changed.
        """
        arrays = _validate_rows(
            self.rows if rows is None else rows,
            self.appearance if appearance is None else appearance,
            self.space,
            count,
        )
        for name, new_array, old_array in (
            ("rows", arrays[0], self.rows),
            ("appearance", arrays[1], self.appearance),
        ):
            if new_array.shape != old_array.shape or new_array.dtype != old_array.dtype:
                raise SceneInvalid(
                    f"is {new_array.dtype} {list(new_array.shape)}, expected {old_array.dtype} {list(old_array.shape)}, "
                    "as before",
                    where=name,
                )
        self.rows, self.appearance, self.count = arrays
        self.origin = self.origin if origin is None else origin
        if cells is not None:
            self.cells = self._next_cells(cells)
            self.cells_version += 1
        self.rows_version += rows is not None
        self.appearance_version += appearance is not None

    def _next_cells(self, cells: np.ndarray) -> np.ndarray:
        valid_cells = _validate_cells(cells, self.per_cell, len(self.rows))
        if self.cells is None or valid_cells.dtype != self.cells.dtype:
            before = "no cells" if self.cells is None else str(self.cells.dtype)
            message = (
                f"the new cells are {valid_cells.dtype}, expected {before} as in the frame before"
            )
            raise SceneInvalid(message, where="cells")
        return valid_cells

    @property
    def degree(self) -> int | None:
        """The SH degree of the appearance; None if the appearance is RGB."""
        return degree_of(self.appearance.shape[1] // 3) if self.space == "sh" else None

    def __len__(self) -> int:
        return len(self.rows)


def _point_spacing(points: Float32[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Return the root mean square distance of each point to its three nearest neighbours."""
    try:
        from scipy.spatial import KDTree
    except ImportError as error:
        raise SceneInvalid(
            "drawing a point cloud needs scipy, which is not installed",
            hint="pip install 'gsgen[runtime]'",
        ) from error
    positions = points.astype(np.float64)
    k = min(3, len(positions) - 1)
    if k < 1:
        return np.full(len(positions), 1e-2)
    distances, _ = KDTree(positions).query(positions, k=k + 1, workers=-1)
    return np.asarray(np.sqrt(np.square(distances[:, 1:]).mean(axis=1)))


def _validate_rows(
    rows: np.ndarray, appearance: np.ndarray, space: Literal["sh", "rgb"], count: int | None
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return validated packed Gaussians and colours in C order, and the number of Gaussians."""
    allowed_channels = layout.APPEARANCE_CHANNELS[space]
    if rows.ndim != 2 or rows.shape[1] != layout.ROW_LENGTH or rows.dtype not in _APPEARANCE_DTYPES:
        raise SceneInvalid(
            f"is {rows.dtype} {list(rows.shape)}, expected float16 or float32 [N, {layout.ROW_LENGTH}]",
            where="rows",
        )
    is_valid = appearance.ndim == 2 and appearance.shape[1] in allowed_channels
    if not is_valid or len(appearance) != len(rows) or appearance.dtype not in _APPEARANCE_DTYPES:
        raise SceneInvalid(
            f"is {appearance.dtype} {list(appearance.shape)}, expected float16 or float32 "
            f"[{len(rows)}, C] with C one of {', '.join(map(str, allowed_channels))} for {space}",
            where="appearance",
        )
    live_count = len(rows) if count is None else int(count)
    if not 0 <= live_count <= len(rows):
        raise SceneInvalid(f"is {live_count}, expected 0 to {len(rows)}", where="count")
    return np.ascontiguousarray(rows), np.ascontiguousarray(appearance), live_count


def _validate_cells(cells: np.ndarray, per_cell: int, rows: int) -> np.ndarray:
    """Validate the rows of cells (groups of Gaussians), and return them in C order."""
    is_valid = (
        cells.ndim == 2
        and cells.shape[1] == layout.ROW_LENGTH
        and cells.dtype in _APPEARANCE_DTYPES
    )
    if per_cell < 1 or not is_valid or len(cells) * per_cell != rows:
        raise SceneInvalid(
            f"is {cells.dtype} {list(cells.shape)} with {per_cell} rows a cell, expected float16 "
            f"or float32 [C, {layout.ROW_LENGTH}] with C × {per_cell} = {rows} rows",
            where="cells",
        )
    return np.ascontiguousarray(cells)

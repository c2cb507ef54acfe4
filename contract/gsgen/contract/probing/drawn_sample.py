"""The input of statistical rules: a sample of visible Gaussians and their neighbours.

A statistic of neighbours needs every row around a row, so a large scene is sampled in patches:
a few rows spread over the scene, each with the rows nearest to it. The inner rows of a patch find
their neighbours within it.
"""

__all__ = [
    "MAX_PLANAR_SCATTER",
    "MIN_DRAWN_ROWS",
    "MIN_LINEAR_SCATTER",
    "SH_OFFSET",
    "DrawnSample",
    "LocalRotations",
    "displayed_colors",
    "draw_sample",
    "fit_local_rotations",
    "spatial_groups",
]

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gsgen.contract._array_types import Bool, Float, Int
from gsgen.contract.probing.outputs import ModelOutputs
from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.layout import COVARIANCE, CULL_OPACITY, OPACITY, POSITION
from gsgen.contract.spec.spherical_harmonics import SH_DC

# Below this number of drawn rows, a statistic says nothing.
MIN_DRAWN_ROWS = 32

# Neighbours lie in a plane (on a line) if the smallest (largest) eigenvalue of their scatter, whose
# trace is 1, is below (above) this on average. Points of a volume have 0.12 (0.57).
MAX_PLANAR_SCATTER, MIN_LINEAR_SCATTER = 0.08, 0.7

# Up to this number of rows, all are compared with each other.
_MAX_WHOLE_ROWS = 1024
# A larger scene is sampled in this many patches of this many rows; the inner ones are measured.
_PATCH_COUNT, _PATCH_ROWS, _INNER_ROW_COUNT = 8, 256, 64
# Rows that are taken evenly from the whole scene for statistics without neighbours.
_MAX_EVEN_ROWS = 1 << 13
_NEIGHBOUR_COUNT = 6
_SPACING_NEIGHBOURS = 3
_MIN_LENGTH = 1e-30


@dataclass(frozen=True, kw_only=True)
class DrawnSample:
    """A sample of the visible Gaussians of one model run, in float64, with nearest neighbours.

    Attributes:
        emission: The outputs that the rows come from.
        even: Packed rows taken evenly from all drawn rows, [e, 10].
        even_color: Their appearance, [e, c]; None if it cannot be read.
        indices: The numbers of the rows of all patches in the output, [n].
        rows: Packed rows of all patches, [n, 10].
        color: Their appearance, [n, c]; None if it cannot be read.
        inner_indices: Indices into ``rows`` of the rows that are measured, [m].
        neighbours: For each of them the nearest other rows, nearest first, [m, k].
        count: Number of drawn rows of the probe.
    """

    emission: ModelOutputs
    even_rows: Float[np.ndarray, "e 10"]
    even_row_color: Float[np.ndarray, "e c"] | None
    indices: Int[np.ndarray, " n"]
    rows: Float[np.ndarray, "n 10"]
    color: Float[np.ndarray, "n c"] | None
    inner_indices: Int[np.ndarray, " m"]
    neighbours: Int[np.ndarray, "m k"]
    count: int

    @cached_property
    def offsets(self) -> Float[np.ndarray, "m k 3"]:
        """The vectors from each sampled Gaussian to its nearest neighbours, in scene units."""
        position = self.rows[:, POSITION]
        return np.asarray(position[self.neighbours] - position[self.inner_indices][:, None])

    @cached_property
    def spacing(self) -> Float[np.ndarray, " m"]:
        """The mean distance of each sampled Gaussian to its three nearest neighbours."""
        distance = np.linalg.norm(self.offsets[:, :_SPACING_NEIGHBOURS], axis=2).mean(axis=1)
        return np.asarray(np.maximum(distance, _MIN_LENGTH))

    @cached_property
    def _variances_and_axes(self) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 3"]]:
        variances, axes = np.linalg.eigh(symmetric(self.rows[self.inner_indices][:, COVARIANCE]))
        return np.maximum(variances, 0.0), axes

    @property
    def sigma(self) -> Float[np.ndarray, "m 3"]:
        """The standard deviations of each sampled Gaussian, the smallest first."""
        return np.asarray(np.sqrt(self._variances_and_axes[0]))

    @property
    def axes(self) -> Float[np.ndarray, "m 3 3"]:
        """The principal axes of each sampled Gaussian as columns, the thinnest first."""
        return self._variances_and_axes[1]

    @cached_property
    def scatter(self) -> Float[np.ndarray, "m 3 3"]:
        """The mean of d dᵀ over the unit vectors d from each sampled Gaussian to its neighbours."""
        length = np.maximum(np.linalg.norm(self.offsets, axis=2, keepdims=True), _MIN_LENGTH)
        unit = self.offsets / length
        return np.asarray(unit.transpose(0, 2, 1) @ unit / unit.shape[1])

    @cached_property
    def scatter_eigenvalues(self) -> Float[np.ndarray, "m 3"]:
        """The eigenvalues of the neighbours' scatter matrix (mean of d dᵀ), the smallest first."""
        return np.linalg.eigvalsh(self.scatter)

    @property
    def is_planar(self) -> bool:
        """Whether the neighbours of most Gaussians lie in planes, as on a surface."""
        return bool(self.scatter_eigenvalues[:, 0].mean() < MAX_PLANAR_SCATTER)

    @property
    def is_linear(self) -> bool:
        """Whether the neighbours of most Gaussians lie on lines, as along a strand of hair."""
        return bool(self.scatter_eigenvalues[:, 2].mean() > MIN_LINEAR_SCATTER)

    def neighbour_alignment(self, axis: int) -> Float[np.ndarray, " m"]:
        """Return the mean of (d · a)² of axes a over unit vectors d to a Gaussian's neighbours."""
        axis_vectors = self.axes[:, :, axis]
        return np.asarray(np.einsum("mi,mij,mj->m", axis_vectors, self.scatter, axis_vectors))


def draw_sample(emission: ModelOutputs) -> DrawnSample | None:
    """Return a sample of the visible Gaussians; None if too few are visible."""
    packed_rows = emission.gaussians
    if packed_rows is None or emission.zeros:
        return None
    drawn_indices = np.flatnonzero(_drawn_mask(emission))
    if len(drawn_indices) < MIN_DRAWN_ROWS:
        return None
    even_indices = drawn_indices[:: -(-len(drawn_indices) // _MAX_EVEN_ROWS)]
    patches = _position_patches(packed_rows[:, POSITION][drawn_indices].astype(np.float32))
    member_indices, inner_indices, neighbours, start = [], [], [], 0
    for patch, measured_count in patches:
        position = packed_rows[:, POSITION][drawn_indices[patch]].astype(np.float64)
        member_indices.append(drawn_indices[patch])
        inner_indices.append(start + np.arange(measured_count))
        neighbours.append(start + _nearest_rows(position, measured_count))
        start += len(patch)
    indices = np.concatenate(member_indices)
    return DrawnSample(
        emission=emission,
        even_rows=packed_rows[even_indices].astype(np.float64),
        even_row_color=_colors(emission, even_indices),
        indices=indices,
        rows=packed_rows[indices].astype(np.float64),
        color=_colors(emission, indices),
        inner_indices=np.concatenate(inner_indices),
        neighbours=np.concatenate(neighbours),
        count=len(drawn_indices),
    )


def _drawn_mask(emission: ModelOutputs) -> Bool[np.ndarray, " n"]:
    """Return the mask of the Gaussians that are finite and opaque enough to change a pixel."""
    assert emission.gaussians is not None
    live = emission.gaussians[: emission.count]
    is_drawn = (live[:, OPACITY] >= CULL_OPACITY) & np.isfinite(live).all(axis=1)
    if emission.appearance is not None:
        is_drawn &= np.isfinite(emission.appearance[: emission.count]).all(axis=1)
    return np.asarray(is_drawn)


def _colors(emission: ModelOutputs, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n c"] | None:
    color = emission.appearance
    return None if color is None else color[rows].astype(np.float64)


def _position_patches(
    position: Float[np.ndarray, "n 3"],
) -> list[tuple[Int[np.ndarray, " p"], int]]:
    """Return clusters of close Gaussians: row indices, and for how many to find neighbours."""
    total = len(position)
    if total <= _MAX_WHOLE_ROWS:
        return [(np.arange(total), total)]
    patches = []
    for middle_row in np.arange(_PATCH_COUNT) * (total // _PATCH_COUNT):
        square = np.square(position - position[middle_row]).sum(axis=1)
        nearest_indices = np.argpartition(square, _PATCH_ROWS)[:_PATCH_ROWS]
        patches.append(
            (nearest_indices[np.argsort(square[nearest_indices], kind="stable")], _INNER_ROW_COUNT)
        )
    return patches


def _nearest_rows(
    position: Float[np.ndarray, "p 3"], measured_count: int
) -> Int[np.ndarray, "m k"]:
    """Return, nearest first, the neighbours' indices of each of the first ``measured_count`` points."""
    square = np.square(position[:measured_count, None] - position[None]).sum(axis=2)
    square[np.arange(measured_count), np.arange(measured_count)] = np.inf
    count = min(_NEIGHBOUR_COUNT, len(position) - 1)
    nearest_indices = np.argpartition(square, count - 1, axis=1)[:, :count]
    order = np.argsort(np.take_along_axis(square, nearest_indices, 1), axis=1, kind="stable")
    return np.asarray(np.take_along_axis(nearest_indices, order, 1))


def spatial_groups(position: Float[np.ndarray, "n 3"], size: int) -> list[Int[np.ndarray, " g"]]:
    """Return groups of close points, of ``size`` to twice as many: halves along the longest side."""
    groups, pending = [], [np.arange(len(position))]
    while pending:
        members = pending.pop()
        if len(members) < 2 * size:
            groups.append(members)
            continue
        axis = int(np.ptp(position[members], axis=0).argmax())
        order = members[np.argsort(position[members, axis], kind="stable")]
        pending += [order[len(order) // 2 :], order[: len(order) // 2]]
    return groups


# A neighbourhood moves rigidly if this fraction of its size remains after the fit, or less.
_MAX_RIGID_RESIDUAL = 0.05
# Neighbours that lie on a line leave the rotation about it open.
_MAX_COLLINEAR_SPREAD = 0.15
_MIN_LENGTH = 1e-30


@dataclass(frozen=True, kw_only=True)
class LocalRotations:
    """The rotation of each sampled Gaussian's neighbourhood between two model runs.

    Attributes:
        rotation: The fitted rotations, [m, 3, 3].
        angle: Their angles, in radians, [m].
        is_rigid: Whether the fit explains the motion, [m].
    """

    rotation: Float[np.ndarray, "m 3 3"]
    angle: Float[np.ndarray, " m"]
    is_rigid: Bool[np.ndarray, " m"]


def fit_local_rotations(
    sample: DrawnSample, later_rows: Float[np.ndarray, "n 10"]
) -> LocalRotations:
    """Fit the rotation of each Gaussian's neighbourhood between two runs (Kabsch 1976).

    Args:
        sample: Drawn rows of the first run.
        later_rows: The same rows of the second run, in the order of ``sample.rows``, float64.
    """
    position = later_rows[:, POSITION]
    a, b = sample.offsets, position[sample.neighbours] - position[sample.inner_indices][:, None]
    left, singular_values, right = np.linalg.svd(b.transpose(0, 2, 1) @ a)
    sign = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= np.where(sign == 0, 1, sign)[:, None]
    rotation = left @ right
    size = np.maximum(np.sqrt(np.square(a).sum(axis=(1, 2))), _MIN_LENGTH)
    residual = np.sqrt(np.square(b - a @ rotation.transpose(0, 2, 1)).sum(axis=(1, 2))) / size
    spread = np.sqrt(singular_values[:, 1] / np.maximum(singular_values[:, 0], _MIN_LENGTH))
    cosine = (np.trace(rotation, axis1=1, axis2=2) - 1) / 2
    return LocalRotations(
        rotation=rotation,
        angle=np.arccos(np.clip(cosine, -1, 1)),
        is_rigid=(residual <= _MAX_RIGID_RESIDUAL) & (spread >= _MAX_COLLINEAR_SPREAD),
    )


# The offset that viewers add to the sum of SH.
SH_OFFSET = 0.5


def displayed_colors(sample: DrawnSample) -> Float[np.ndarray, "e 3"] | None:
    """Return the unclamped RGB of sampled Gaussians; None if the appearance cannot be read."""
    if sample.even_row_color is None or sample.emission.declared is None:
        return None
    color = sample.even_row_color[:, :3]
    return SH_OFFSET + SH_DC * color if sample.emission.is_sh else color

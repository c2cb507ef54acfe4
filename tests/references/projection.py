"""NumPy references of the projection kernels: what each shader must return."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64, Shaped, UInt32

from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.runtime.gpu.splat_residency import PAGE_ROWS
from gsgen.runtime.kernels.project.cull_slots import CULL_MARGIN
from gsgen.runtime.kernels.project.project import NO_HARMONICS
from gsgen.runtime.kernels.project.projections import Projection
from gsgen.runtime.kernels.project.tally_keys import BIN_COUNT
from gsgen.runtime.kernels.shared.shader import MIN_EIGENVALUE_GAP, NO_ID, POLE, TILE
from gsgen.runtime.scene.camera import DEFAULT_DILATION
from gsgen.runtime.scene.distortion import Distortion
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.scene.splat_pool import REACH_SIGMAS


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Projected:
    """Splats projected into the image: centres, inverse covariances, depths, colours; float64.

    Attributes:
        drawn: Mask of drawn Gaussians; the other fields are undefined for the rest.
        mean: Pixels, relative to the frame's origin.
        conic: Inverse 2D covariance: xx, xy, yy.
        strength: Logarithm of the opacity over CULL_OPACITY.
        depth: Along the camera's +z; in a fisheye and a panorama from the camera.
        color: Red, green, blue.
    """

    drawn: Bool[np.ndarray, " n"]
    mean: Float[np.ndarray, "n 2"]
    conic: Float[np.ndarray, "n 3"]
    strength: Float[np.ndarray, " n"]
    depth: Float[np.ndarray, " n"]
    color: Float[np.ndarray, "n 3"]


def project_reference(
    data: SplatData,
    frame: Shaped[np.ndarray, ""],
    page: Shaped[np.ndarray, ""],
    projection: Projection = "plane",
) -> Projected:
    """Project Gaussians in float64: the reference of ``project.wgsl``.

    ``projection`` tells cameras with a lens; panoramas have a period in their frame.
    """
    rows = data.rows.astype(np.float64)
    linear, linear_rest, to_sh = (
        np.asarray(page[name], np.float64)[:, :3].T
        for name in ("linear", "linear_rest", "local_to_sh")
    )
    linear = linear + linear_rest
    offset = rows[:, :3] - np.float64(page["eye"]) - np.float64(page["eye_rest"])
    with np.errstate(all="ignore"):
        position = offset @ linear.T
        flat = bool(np.any(page["forward"]))
        depth, slope, jacobian = (
            _unrolled(position, linear)
            if frame["period"]
            else _perspective_covariance(position, linear, frame, flat=flat)
        )
        is_in_range = np.ones(len(rows), bool)
        if projection == "fisheye":
            depth, slope, jacobian = _angles_from_axis(position, linear)
        if projection in ("distorted", "fisheye"):
            is_in_range = np.linalg.norm(slope, axis=1) < frame["ray_limit"]
            slope, jacobian = _through_lens(slope, jacobian, frame)
        jacobian = frame["focal"][:, None] * jacobian
        covariance = jacobian @ symmetric(rows[:, layout.COVARIANCE]) @ jacobian.transpose(0, 2, 1)
        dilated = covariance + (DEFAULT_DILATION + frame["extra_dilation"]) * np.eye(2)
        opacity = rows[:, layout.OPACITY] * page["opacity_scale"]
        if data.cells is not None and page["per_cell"]:
            cell = (page["first_row"] + np.arange(len(rows))) // page["per_cell"]
            visibility = data.cells[cell, layout.VISIBILITY].astype(np.float64)
            opacity = opacity * visibility * (1 - depth * page["inverse_range"])
        opacity = np.minimum(opacity, 1)
        if page["mip"]:
            share = np.linalg.det(covariance) / np.linalg.det(dilated)
            opacity = opacity * np.sqrt(np.maximum(share, 0))
        color = data.appearance[:, :3].astype(np.float64)
        if page["degree"] != NO_HARMONICS:
            toward = (np.tile(page["forward"], (len(position), 1)) if flat else offset) @ to_sh.T
            weights = basis(
                toward / np.linalg.norm(toward, axis=1, keepdims=True), int(page["degree"])
            )
            sh = data.appearance.reshape(len(rows), -1, 3)[:, : weights.shape[1]]
            color = 0.5 + np.einsum("nk,nkc->nc", weights, sh.astype(np.float64))
        drawn = (depth > frame["near"]) & is_in_range & (opacity >= layout.CULL_OPACITY)
        drawn &= np.isfinite(rows).all(axis=1) & np.isfinite(color).all(axis=1)
        drawn &= (rows[:, :3] >= page["clip_low"]).all(axis=1)
        drawn &= (rows[:, :3] <= page["clip_high"]).all(axis=1)
        drawn &= (np.linalg.det(dilated) > 0) & (dilated[:, 0, 0] > 0) & (dilated[:, 1, 1] > 0)
        drawn &= np.arange(len(rows)) < page["count"]
        strength = np.log(opacity / layout.CULL_OPACITY)
        conic = np.full((len(rows), 3), np.nan)
        conic[drawn] = np.linalg.inv(dilated[drawn])[:, [0, 0, 1], [0, 1, 1]]
        mean = frame["focal"] * slope + frame["center"]
        if frame["period"]:
            middle = frame["size"][0] / 2 - frame["origin"][0]
            turns = np.round((mean[:, 0] - middle) / frame["period"])
            mean[:, 0] -= turns * frame["period"]
    return Projected(
        drawn=drawn,
        mean=mean,
        conic=conic,
        strength=strength,
        depth=depth,
        color=np.maximum(color, 0),
    )


def depth_reference(
    depth: Float[np.ndarray, " n"],
) -> tuple[UInt32[np.ndarray, " n"], UInt32[np.ndarray, " n"]]:
    """Return keys that sort depths (float32 and rounding error), as ``exact_depth.wgsl`` must."""
    high = depth.astype(np.float32)
    low = (depth - high.astype(np.float64)).astype(np.float32)
    bits = low.view(np.uint32)
    ordered = np.where(low < 0, ~bits, bits ^ np.uint32(0x80000000))
    return high.view(np.uint32), np.where(low == 0, np.uint32(0x80000000), ordered)


def _perspective_covariance(
    position: np.ndarray, linear: np.ndarray, frame: Shaped[np.ndarray, ""], *, flat: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points to a plane (pinhole, orthographic): depths, slopes and Jacobians."""
    divisor = np.ones((len(position), 1)) if flat else position[:, 2:]
    slope = position[:, :2] / divisor
    clipped_slope = np.clip(slope, frame["slope_low"], frame["slope_high"]) * (not flat)
    moved = (linear[:2] - clipped_slope[:, :, None] * linear[2]) / divisor[:, :, None]
    return position[:, 2], slope, moved


def _unrolled(
    position: np.ndarray, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points to a panorama: distances, longitudes and latitudes, and Jacobians."""
    distance, level = (np.linalg.norm(position, axis=1), np.hypot(position[:, 0], position[:, 2]))
    angles = np.stack(
        [np.arctan2(position[:, 0], position[:, 2]), np.arctan2(position[:, 1], level)], 1
    )
    sin, cos = np.sin(angles[:, 0]), np.cos(angles[:, 0])
    zero = np.zeros(len(position))
    width = np.maximum(level / distance, POLE)
    high = position[:, 1] / distance
    tile_columns = np.stack([cos / width, zero, -sin / width], 1)
    down = np.stack([-sin * high, level / distance, -cos * high], 1)
    return distance, angles, np.stack([tile_columns, down], 1) @ linear / distance[:, None, None]


def _angles_from_axis(
    position: np.ndarray, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points to a fisheye: distances, angles θ (x, y)/ρ, and Jacobians.

    A step outwards changes θ by (cos θ, −sin θ)/r; a step around the axis turns it by θ/ρ.
    """
    distance, level = np.linalg.norm(position, axis=1), np.hypot(position[:, 0], position[:, 1])
    angle, turn = np.arctan2(level, position[:, 2]), np.arctan2(position[:, 1], position[:, 0])
    sin, cos = np.sin(turn), np.cos(turn)
    zero, growth = np.zeros(len(position)), np.where(level > 0, angle * distance / level, 1)
    outward = np.stack([np.cos(angle) * cos, np.cos(angle) * sin, -np.sin(angle)], 1)
    around = np.stack([-sin, cos, zero], 1) * growth[:, None]
    rows = [cos[:, None] * outward - sin[:, None] * around]
    rows.append(sin[:, None] * outward + cos[:, None] * around)
    points = angle[:, None] * np.stack([cos, sin], 1)
    return distance, points, np.stack(rows, 1) @ linear / distance[:, None, None]


def _through_lens(
    points: np.ndarray, jacobian: np.ndarray, frame: Shaped[np.ndarray, ""]
) -> tuple[np.ndarray, np.ndarray]:
    """Return where a lens moves points, linearly beyond the image's slopes, and Jacobians."""
    names = ("radial", "divisor", "tangential", "prism")
    lens = Distortion(**{name: tuple(frame[name].astype(float).tolist()) for name in names})
    inside = np.clip(points, frame["slope_low"], frame["slope_high"])
    derivative = lens.jacobian(inside)
    beyond = (derivative @ (points - inside)[:, :, None])[:, :, 0]
    return lens.distorted(inside) + beyond, derivative @ jacobian


def normals_reference(
    covariance: Float[np.ndarray, "n 3 3"], position: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return the normals (shortest axes) of non-spherical Gaussians, in camera space.

    This is the reference of ``normals.wgsl``; arguments are in camera space, too.
    """
    _, vectors = np.linalg.eigh(covariance)
    thinnest = vectors[:, :, 0]
    is_averted = np.einsum("nd,nd->n", thinnest, position) > 0
    return np.where(is_averted[:, None], -thinnest, thinnest)


def visible_slots_reference(
    slots: Shaped[np.ndarray, " s"], frame: Shaped[np.ndarray, ""], page: Shaped[np.ndarray, ""]
) -> Bool[np.ndarray, " s"]:
    """Return the mask of pool slots (streamed tiles) in view: ``cull_slots.wgsl`` in NumPy.

    All eight corners of a box are tested against each of the four planes and the near plane, which
    is another way to the same result as the shader's extents.
    """
    drawn = (slots["fade"] > 0) & (slots["live"] > 0)
    dilation = REACH_SIGMAS * np.sqrt(DEFAULT_DILATION + frame["extra_dilation"])
    if (CULL_MARGIN * frame["size"] < dilation).any():
        return np.asarray(drawn)
    linear = np.asarray(page["linear"], np.float64)[:, :3].T
    boxes = np.stack([slots["low"], slots["high"]], axis=1).astype(np.float64)
    choices = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T
    corners = np.take_along_axis(boxes, np.broadcast_to(choices, (len(slots), 8, 3)), axis=1)
    eye = slots["eye"].astype(np.float64) + slots["eye_rest"]
    view_corners = (corners - eye[:, None]) @ linear.T
    inside_low = view_corners[..., :2] - frame["slope_low"] * view_corners[..., 2:] >= 0
    inside_high = view_corners[..., :2] - frame["slope_high"] * view_corners[..., 2:] <= 0
    sides = inside_low.any(axis=1).all(axis=1) & inside_high.any(axis=1).all(axis=1)
    in_front = (view_corners[..., 2] > frame["near"]).any(axis=1)
    return np.asarray(drawn & sides & in_front)


def circle_reference(
    covariance: Float[np.ndarray, "n 2 2"], reach: float
) -> Float[np.ndarray, " n"]:
    """Return a circle's radius in pixels for each 2D covariance: reference of ``circle.wgsl``.

    Args:
        covariance: 2D covariances in pixels², with the dilation.
        reach: Radius in standard deviations.
    """
    middle = np.trace(covariance, axis1=1, axis2=2) / 2
    apart = np.sqrt(np.maximum(MIN_EIGENVALUE_GAP, middle**2 - np.linalg.det(covariance)))
    return np.asarray(np.ceil(reach * np.sqrt(middle + apart)))


def box_reference(
    mean: Float[np.ndarray, "2"], radius: float, size: tuple[int, int]
) -> Bool[np.ndarray, "rows columns"]:
    """Return the mask of image tiles that a circle touches: the reference of ``cell_box.wgsl``.

    ``mean``, ``radius`` and the image ``size`` are in pixels; panoramas are not covered.
    """
    tile_columns, down = (np.arange(-(-side // TILE)) for side in size)
    low = np.floor((mean - 0.5 - radius) / TILE)
    high = np.floor((mean - 0.5 + radius + TILE - 1) / TILE)
    columns, rows = (
        (along >= low[axis]) & (along < high[axis])
        for axis, along in enumerate((tile_columns, down))
    )
    return np.asarray(rows[:, None] & columns)


def tally_reference(
    keys: UInt32[np.ndarray, " n"], low: int, high: int, shift: int
) -> Int64[np.ndarray, " m"]:
    """Count sort keys from ``low`` to before ``high``: the reference of ``tally_keys.wgsl``."""
    counted = keys[(keys >= low) & (keys < high)]
    return np.bincount((counted - np.uint32(low)) >> np.uint32(shift), minlength=BIN_COUNT)


def place_reference(
    keys: UInt32[np.ndarray, " n"], low: int, high: int, before: int
) -> UInt32[np.ndarray, " n"]:
    """Return consecutive indices of a depth slab's Gaussians; 2³² − 1 marks all others.

    The reference of ``place_splats.wgsl``: the first index is ``before``.
    """
    is_in_slab = (keys >= low) & (keys < high)
    return np.where(is_in_slab, before + np.cumsum(is_in_slab) - 1, NO_ID).astype(np.uint32)


def live_counts_reference(total: int, pages: int) -> UInt32[np.ndarray, " n"]:
    """Count the used rows of each buffer of Gaussians: the reference of ``live_counts.wgsl``."""
    first = np.arange(pages) * PAGE_ROWS
    return np.clip(total - first, 0, PAGE_ROWS).astype(np.uint32)


def repack_reference(
    rows: Float[np.ndarray, "n c"], words: int, *, half_target: bool
) -> UInt32[np.ndarray, "n w"]:
    """Copy rows into rows of whole 32-bit words: the NumPy reference of ``repack_rows.wgsl``."""
    dtype = np.float16 if half_target else np.float32
    target = np.zeros((len(rows), words * (2 if half_target else 1)), dtype)
    target[:, : rows.shape[1]] = rows
    return target.view(np.uint32)


def unpack_rows(packed: UInt32[np.ndarray, "n 8"]) -> Float32[np.ndarray, "n 10"]:
    """Unpack Gaussians of 32 bytes each, as the shader ``page.wgsl`` does."""
    rows = np.empty((len(packed), layout.ROW_LENGTH), np.float32)
    rows[:, :4] = packed[:, :4].view(np.float32)
    fixed_point = packed[:, 4:7].copy().view(np.int16).astype(np.float32) / 32_767
    scale = packed[:, 7:].view(np.float32)
    factor = np.zeros((len(packed), 3, 3), np.float32)
    columns, lines = np.triu_indices(3)
    factor[:, lines, columns] = fixed_point * scale
    full = factor @ factor.transpose(0, 2, 1)
    rows[:, layout.COVARIANCE] = full[:, columns, lines]
    return rows

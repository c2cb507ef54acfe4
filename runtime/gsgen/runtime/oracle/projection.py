"""Projects Gaussians to the image in float64, for the reference renderers.

It shares no code with the kernels, nor the method where two methods exist.
"""

__all__ = [
    "FRAGILE_BAND",
    "MAX_ALPHA",
    "MIN_ALPHA",
    "TIE_TOLERANCE",
    "Picture",
    "ScreenEllipses",
    "Splats",
    "drawn_splats",
    "ellipses",
    "pixel_offset",
]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float, Int64

from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.spherical_harmonics import basis, degree_of
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet

MIN_ALPHA: Final = 1 / 255
MAX_ALPHA: Final = 0.99
FRAGILE_BAND: Final = (
    2e-3  # relative distance from a threshold within which float32 may decide otherwise
)
TIE_TOLERANCE: Final = 1e-12  # relative difference of depths that sums of two floats resolve
_JACOBIAN_MARGIN: Final = 0.3
_MIN_POLE_COSINE: Final = 1e-3


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Picture:
    """The image, depths, ids and normals that a reference renderer returns.

    Attributes:
        rgba: Colours multiplied by alpha, and alpha.
        depth: Mean depth; infinite where nothing is drawn.
        median_depth: Depth of the Gaussian that took half of the light.
        ids: Index of that Gaussian in the scene; −1 for none.
        normal: Unit vectors in world space; zero where nothing is drawn.
        fragile: Pixels so close to a threshold or a change of order that float32 may decide
            otherwise.
        fragile_median: The same for the median depth and the ids.
        visible: Number of Gaussians that reach a pixel's centre.
    """

    rgba: Float[np.ndarray, "h w 4"]
    depth: Float[np.ndarray, "h w"]
    median_depth: Float[np.ndarray, "h w"]
    ids: Int64[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    fragile: Bool[np.ndarray, "h w"]
    fragile_median: Bool[np.ndarray, "h w"]
    visible: int


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScreenEllipses:
    """The ellipses of Gaussians, or of cells (groups of Gaussians), in an image.

    Attributes:
        mean: Centres, in pixels.
        covariance: 2D covariances, in pixels².
        dilated_covariance: 2D covariances with the dilation.
        depth: Along the camera's +z; in a fisheye and a panorama from the camera.
        is_finite: Whether a row is finite, its ellipse has a positive finite size, and its centre is
            within the range of the lens.
        sigma: Covariances in camera space.
        position: Centres in camera space.
    """

    mean: Float[np.ndarray, "n 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    dilated_covariance: Float[np.ndarray, "n 2 2"]
    depth: Float[np.ndarray, " n"]
    is_finite: Bool[np.ndarray, " n"]
    sigma: Float[np.ndarray, "n 3 3"]
    position: Float[np.ndarray, "n 3"]


def ellipses(
    rows: Float[np.ndarray, "n 10"], splat_set: SplatSet, camera: Camera
) -> ScreenEllipses:
    """Project Gaussians, or groups (cells) of them, of a splat set into an image, as ellipses."""
    matrix = splat_set.rows_to_world
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    rotation = camera.view[:3, :3]
    with np.errstate(all="ignore"):  # rows that are not finite are not sound
        # Step 1: turn centres and covariances into camera space.
        position = (rows[:, :3] @ linear.T + offset - camera.eye) @ rotation.T
        camera_from_model = rotation @ linear
        sigma = np.einsum(
            "ij,njk,lk->nil", camera_from_model, symmetric(rows[:, 4:]), camera_from_model
        )
        # Step 2: project them by the derivative of the projection at the centre, and dilate.
        mean, covariance = _project_planar(position, sigma, camera)
        dilated_covariance = covariance + camera.dilation * np.eye(2)
        depth = np.linalg.norm(position, axis=1) if camera.has_ray_depth else position[:, 2]
        # Step 3: a row is drawn only if all of its numbers make an ellipse.
        is_finite = np.isfinite(rows).all(axis=1) & np.isfinite(dilated_covariance).all(axis=(1, 2))
        is_finite &= _is_within_lens(position, camera)
        is_finite &= (
            (np.linalg.det(dilated_covariance) > 0)
            & (dilated_covariance[:, 0, 0] > 0)
            & (dilated_covariance[:, 1, 1] > 0)
        )
    return ScreenEllipses(
        mean=mean,
        covariance=covariance,
        dilated_covariance=dilated_covariance,
        depth=depth,
        is_finite=is_finite,
        sigma=sigma,
        position=position,
    )


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Splats:
    """The drawn Gaussians of a scene, one row of each array per Gaussian.

    Attributes:
        mean: Centres, in pixels.
        covariance: 2D covariances with the dilation, in pixels².
        opacity: Opacities in (0, 1].
        depth: Depths.
        color: Colours, clamped to ≥ 0.
        normal: Normals in world space.
        index: Indices in the scene.
    """

    mean: Float[np.ndarray, "n 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    opacity: Float[np.ndarray, " n"]
    depth: Float[np.ndarray, " n"]
    color: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    index: Int64[np.ndarray, " n"]

    def take(self, rows: Bool[np.ndarray, " n"] | Int64[np.ndarray, " m"]) -> "Splats":
        """Return the Gaussians that a mask or an array of indices selects."""
        return Splats(**{name: getattr(self, name)[rows] for name in self.__slots__})


def drawn_splats(
    splat_set: SplatSet, camera: Camera, first: int, visibility: Float[np.ndarray, " n"] | float = 1
) -> Splats:
    """Project the Gaussians of a splat set; drop clipped, nearly transparent and invalid ones.

    Args:
        splat_set: The set.
        camera: The camera.
        first: Index of the set's first Gaussian in the scene.
        visibility: Factor of the opacities; for weighted sums, the visibility of each row's cell.
    """
    data, depth_range, clip = splat_set.data, splat_set.depth_range, splat_set.rows_clip
    rows = data.rows[: data.count].astype(np.float64)
    shapes = ellipses(rows, splat_set, camera)
    with np.errstate(all="ignore"):  # rows that are not finite are dropped at the end
        # Step 1: scale the opacity, fade it with the depth, and dim splats thinner than a pixel.
        opacity = rows[:, 3] * splat_set.opacity_scale * visibility
        if depth_range is not None:
            opacity = opacity * (1 - shapes.depth / depth_range)
        opacity = np.minimum(opacity, 1)
        if splat_set.antialias == "mip":
            ratio = np.linalg.det(shapes.covariance) / np.linalg.det(shapes.dilated_covariance)
            opacity = opacity * np.sqrt(np.maximum(ratio, 0))
        color = _colors(splat_set, camera)
        low, high = (-np.inf, np.inf) if clip is None else (clip.low, clip.high)
        # Step 2: drop what is clipped, too near, nearly transparent or not finite.
        is_drawn = shapes.is_finite & (shapes.depth > camera.near) & (opacity >= MIN_ALPHA)
        is_drawn &= ((rows[:, :3] >= low) & (rows[:, :3] <= high)).all(axis=1)
        is_drawn &= np.isfinite(color).all(axis=1)
    forward = np.tile([0.0, 0.0, 1.0], (len(rows), 1))
    view_direction = forward if camera.kind == "orthographic" else shapes.position
    return Splats(
        mean=shapes.mean[is_drawn],
        covariance=shapes.dilated_covariance[is_drawn],
        opacity=opacity[is_drawn],
        depth=shapes.depth[is_drawn],
        color=np.maximum(color[is_drawn], 0),
        normal=_shortest_axes(shapes.sigma[is_drawn], view_direction[is_drawn])
        @ camera.view[:3, :3],
        index=first + np.flatnonzero(is_drawn),
    )


def _project_planar(
    position: np.ndarray, sigma: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return the projected centres of Gaussians in pixels, and their 2D covariances."""
    focal = np.array([camera.fx, camera.fy])
    center = np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    if camera.kind == "orthographic":
        forward = np.diag(focal) @ np.eye(2, 3)
        return focal * position[:, :2] + center, forward @ sigma @ forward.T
    if camera.kind == "panorama":
        return _project_panorama(position, sigma, focal, center)
    if camera.kind == "fisheye" or camera.distortion is not None:
        return _project_lens(position, sigma, camera)
    # Far beside the image the derivative is that at its margin: else it would grow without limit.
    slope = position[:, :2] / position[:, 2:]
    low = -(center + _JACOBIAN_MARGIN * size / 2) / focal
    high = (size - center + _JACOBIAN_MARGIN * size / 2) / focal
    clipped_slope = np.clip(slope, low, high)
    jacobian = np.zeros((len(position), 2, 3))
    jacobian[:, [0, 1], [0, 1]] = focal / position[:, 2:]
    jacobian[:, :, 2] = -focal * clipped_slope / position[:, 2:]
    return focal * slope + center, np.einsum("nij,njk,nlk->nil", jacobian, sigma, jacobian)


def _project_lens(
    position: np.ndarray, sigma: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of Gaussians seen through a lens, in pixels, and their 2D covariances."""
    low, high = camera.plane_bounds()
    margin = _JACOBIAN_MARGIN / 2 * (high - low)
    bounds = np.minimum(low - margin, 0), np.maximum(high + margin, 0)
    if camera.kind == "fisheye":
        points, jacobian = _fisheye(position)
    else:
        points, jacobian = _pinhole(position, bounds)
    if camera.distortion is not None:
        # Far beside the image the lens goes on linearly.
        inside = np.clip(points, *bounds)
        derivative = camera.distortion.jacobian(inside)
        beyond = np.einsum("nij,nj->ni", derivative, points - inside)
        points, jacobian = camera.distortion.distorted(inside) + beyond, derivative @ jacobian
    focal, center = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    jacobian = focal[:, None] * jacobian
    return focal * points + center, jacobian @ sigma @ jacobian.transpose(0, 2, 1)


def _pinhole(
    position: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes of points, [n, 2], and their derivatives, constant beyond the bounds."""
    slope = position[:, :2] / position[:, 2:]
    clipped_slope = np.clip(slope, *bounds)
    jacobian = np.tile(np.eye(2, 3), (len(position), 1, 1))
    jacobian[:, :, 2] = -clipped_slope
    return slope, jacobian / position[:, 2, None, None]


def _fisheye(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles of points from the axis, as vectors [n, 2], and their derivatives.

    With A = θ/ρ these are A (x, y); the derivative of A by ρ is (z/r² − A)/ρ, by z −1/r².
    """
    planar, z = position[:, :2], position[:, 2]
    rho, squared_distance = np.linalg.norm(planar, axis=1), np.square(position).sum(axis=1)
    ratio = np.where(rho > 0, np.arctan2(rho, z) / rho, 1 / z)
    by_rho = np.where(rho > 0, (z / squared_distance - ratio) / rho, 0)
    unit = np.where(rho[:, None] > 0, planar / rho[:, None], 0)
    jacobian = np.zeros((len(position), 2, 3))
    jacobian[:, :, :2] = ratio[:, None, None] * np.eye(2)
    jacobian[:, :, :2] += by_rho[:, None, None] * planar[:, :, None] * unit[:, None, :]
    jacobian[:, :, 2] = -planar / squared_distance[:, None]
    return planar * ratio[:, None], jacobian


def _is_within_lens(position: np.ndarray, camera: Camera) -> np.ndarray:
    """Return whether the rays to points are within the range of the camera's lens."""
    rho, z = np.linalg.norm(position[:, :2], axis=1), position[:, 2]
    if camera.kind == "fisheye":
        return np.asarray(np.arctan2(rho, z) < camera.ray_limit)
    if camera.distortion is not None:
        return np.asarray(rho / z < camera.ray_limit)
    return np.ones(len(position), bool)


def _project_panorama(
    position: np.ndarray, sigma: np.ndarray, focal: np.ndarray, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of Gaussians in a panorama, in pixels, and their 2D covariances."""
    distance = np.linalg.norm(position, axis=1)
    longitude, latitude = (
        np.arctan2(position[:, 0], position[:, 2]),
        np.arcsin(position[:, 1] / distance),
    )
    forward = np.stack([np.sin(longitude), np.cos(longitude)], 1)
    east_direction = np.stack([forward[:, 1], np.zeros(len(position)), -forward[:, 0]], 1)
    sin, cos = np.sin(latitude), np.cos(latitude)
    south = np.stack([-sin * forward[:, 0], cos, -sin * forward[:, 1]], 1)
    latitude_radius = distance * np.maximum(
        cos, _MIN_POLE_COSINE
    )  # radius of the circle of latitude
    jacobian = np.stack([east_direction / latitude_radius[:, None], south / distance[:, None]], 1)
    jacobian *= focal[:, None]
    mean = focal * np.stack([longitude, latitude], 1) + center
    return mean, jacobian @ sigma @ jacobian.transpose(0, 2, 1)


def _colors(splat_set: SplatSet, camera: Camera) -> Float[np.ndarray, "n 3"]:
    """Return the RGB colours of a splat set's Gaussians, unclamped: SH may give negative values."""
    data = splat_set.data
    channels = data.appearance[: data.count].astype(np.float64)
    if data.space == "rgb":
        return np.asarray(channels[:, :3])
    matrix = splat_set.rows_to_world
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    # Harmonics turn with the set: its transform is a stretch and then this rotation.
    left_vectors, _, right = np.linalg.svd(linear)
    rows = data.rows[: data.count, :3].astype(np.float64)
    offsets = rows @ linear.T + offset - camera.eye
    if camera.kind == "orthographic":
        offsets = np.tile(camera.view[2, :3], (len(rows), 1))
    camera_direction = offsets @ (left_vectors @ right)
    camera_direction /= np.linalg.norm(camera_direction, axis=1, keepdims=True)
    sh = channels.reshape(len(rows), channels.shape[1] // 3, 3)  # there may be no rows
    degree = degree_of(sh.shape[1])
    degree = degree if splat_set.degree is None else min(degree, splat_set.degree)
    weights = basis(camera_direction, degree)
    sums = np.einsum("nk,nkc->nc", weights, sh[:, : weights.shape[1]])
    return np.asarray(0.5 + sums)


def _shortest_axes(sigma: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return Gaussians' normals: shortest axes turned to the camera; spheres face the camera."""
    values, eigenvectors = np.linalg.eigh(sigma)
    is_isotropic = values[:, 1] - values[:, 0] <= 1e-5 * values[:, 2]
    camera_direction = -position / np.linalg.norm(position, axis=1, keepdims=True)
    axes = np.where(is_isotropic[:, None], camera_direction, eigenvectors[:, :, 0])
    faces_away = np.einsum("nd,nd->n", axes, position) > 0
    return np.asarray(np.where(faces_away[:, None], -axes, axes))


def pixel_offset(
    pixels: Float[np.ndarray, " n"], mean: float, camera: Camera
) -> Float[np.ndarray, " n"]:
    """Return the horizontal distances of pixels to a Gaussian; in a panorama, the shorter way."""
    if camera.kind != "panorama":
        return pixels - mean
    rotation = 2 * np.pi * camera.fx
    return np.asarray((pixels - mean + rotation / 2) % rotation - rotation / 2)

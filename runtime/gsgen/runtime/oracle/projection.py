"""Where Gaussians are in the image, in float64: what all oracles have in common.

It shares no code with the kernels, and no method where there are two.
"""

__all__ = ["Ellipses", "Picture", "across", "colors", "ellipses", "normals"]

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from jaxtyping import Bool, Float, Int64

from gsgen.contract.spec.geometry import symmetric
from gsgen.contract.spec.spherical_harmonics import basis, degree_of
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet

_MARGIN: Final = 0.3
_POLE: Final = 1e-3
_DILATION: Final = 0.3


@final
@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What an oracle makes; see :class:`gsgen.runtime.scene.frame.Frame`.

    Attributes:
        rgba: Colours multiplied by alpha, and alpha.
        depth: Mean depth, infinite where nothing is.
        median_depth: Depth of what took half of the light.
        ids: Its place in the scene; −1 for none.
        normal: Unit vectors in world space; zero where nothing is.
        fragile: Pixels where a threshold or an order is so close that float32 may decide
            otherwise: the declared discontinuities.
        fragile_median: The same for the median.
        visible: How many Gaussians reach a pixel's centre.
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
@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """What packed rows are in an image.

    Attributes:
        mean: Centres, in pixels.
        bare: 2D covariances, in pixels².
        wide: The same with the dilation.
        depth: Along the camera's +z; in a panorama from its centre.
        sound: Whether a row is finite and its ellipse is one.
        sigma: Covariances in camera space.
        at: Centres in camera space.
    """

    mean: Float[np.ndarray, "n 2"]
    bare: Float[np.ndarray, "n 2 2"]
    wide: Float[np.ndarray, "n 2 2"]
    depth: Float[np.ndarray, " n"]
    sound: Bool[np.ndarray, " n"]
    sigma: Float[np.ndarray, "n 3 3"]
    at: Float[np.ndarray, "n 3"]


def ellipses(rows: Float[np.ndarray, "n 10"], one: SplatSet, camera: Camera) -> Ellipses:
    """Return where packed rows of a set are in an image; opacities do not count."""
    linear, offset = one.transform[:3, :3], one.transform[:3, 3]
    turn = camera.view[:3, :3]
    with np.errstate(all="ignore"):  # rows that are not finite are not sound
        at = (rows[:, :3] @ linear.T + offset - camera.eye) @ turn.T
        both = turn @ linear
        sigma = np.einsum("ij,njk,lk->nil", both, symmetric(rows[:, 4:]), both)
        mean, bare = _flattened(at, sigma, camera)
        wide = bare + _DILATION * np.eye(2)
        depth = np.linalg.norm(at, axis=1) if camera.kind == "panorama" else at[:, 2]
        sound = np.isfinite(rows).all(axis=1) & np.isfinite(wide).all(axis=(1, 2))
        sound &= (np.linalg.det(wide) > 0) & (wide[:, 0, 0] > 0) & (wide[:, 1, 1] > 0)
    return Ellipses(mean, bare, wide, depth, sound, sigma, at)


def normals(
    found: Ellipses, kept: Bool[np.ndarray, " n"], camera: Camera
) -> Float[np.ndarray, "m 3"]:
    """Return in world space the normals of those ellipses that are kept."""
    flat = np.tile([0.0, 0.0, 1.0], (len(found.at), 1))
    sight = flat if camera.kind == "orthographic" else found.at
    return np.asarray(_thinnest(found.sigma[kept], sight[kept]) @ camera.view[:3, :3])


def _flattened(
    at: np.ndarray, sigma: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return where centres are in the image, and their 2D covariances."""
    focal = np.array([camera.fx, camera.fy])
    center = np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    if camera.kind == "orthographic":
        ahead = np.diag(focal) @ np.eye(2, 3)
        return focal * at[:, :2] + center, ahead @ sigma @ ahead.T
    if camera.kind == "panorama":
        return _unrolled(at, sigma, focal, center)
    slope = at[:, :2] / at[:, 2:]
    low = -(center + _MARGIN * size / 2) / focal
    high = (size - center + _MARGIN * size / 2) / focal
    bent = np.clip(slope, low, high)
    jacobian = np.zeros((len(at), 2, 3))
    jacobian[:, [0, 1], [0, 1]] = focal / at[:, 2:]
    jacobian[:, :, 2] = -focal * bent / at[:, 2:]
    return focal * slope + center, np.einsum("nij,njk,nlk->nil", jacobian, sigma, jacobian)


def _unrolled(
    at: np.ndarray, sigma: np.ndarray, focal: np.ndarray, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the same in a panorama: what lies east and south of each centre, as angles."""
    distance = np.linalg.norm(at, axis=1)
    longitude, latitude = np.arctan2(at[:, 0], at[:, 2]), np.arcsin(at[:, 1] / distance)
    ahead = np.stack([np.sin(longitude), np.cos(longitude)], 1)
    east = np.stack([ahead[:, 1], np.zeros(len(at)), -ahead[:, 0]], 1)
    sin, cos = np.sin(latitude), np.cos(latitude)
    south = np.stack([-sin * ahead[:, 0], cos, -sin * ahead[:, 1]], 1)
    circle = distance * np.maximum(cos, _POLE)  # how far it is around the axis
    jacobian = np.stack([east / circle[:, None], south / distance[:, None]], 1)
    jacobian *= focal[:, None]
    mean = focal * np.stack([longitude, latitude], 1) + center
    return mean, jacobian @ sigma @ jacobian.transpose(0, 2, 1)


def colors(one: SplatSet, camera: Camera) -> Float[np.ndarray, "n 3"]:
    """Return what colour the live rows of a set have; it may be negative."""
    data = one.data
    channels = data.appearance[: data.count].astype(np.float64)
    if data.space == "rgb":
        return np.asarray(channels[:, :3])
    linear, offset = one.transform[:3, :3], one.transform[:3, 3]
    left, _, right = np.linalg.svd(linear)
    rows = data.rows[: data.count, :3].astype(np.float64)
    away = rows @ linear.T + offset - camera.eye
    if camera.kind == "orthographic":
        away = np.tile(camera.view[2, :3], (len(rows), 1))
    toward = away @ (left @ right)
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    sh = channels.reshape(len(rows), channels.shape[1] // 3, 3)  # there may be no rows
    degree = degree_of(sh.shape[1])
    degree = degree if one.degree is None else min(degree, one.degree)
    weights = basis(toward, degree)
    sums = np.einsum("nk,nkc->nc", weights, sh[:, : weights.shape[1]])
    return np.asarray(0.5 + sums)


def _thinnest(sigma: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return unit vectors along the shortest axis, towards the camera; at it from a ball."""
    values, vectors = np.linalg.eigh(sigma)
    ball = values[:, 1] - values[:, 0] <= 1e-5 * values[:, 2]
    toward = -at / np.linalg.norm(at, axis=1, keepdims=True)
    found = np.where(ball[:, None], toward, vectors[:, :, 0])
    away = np.einsum("nd,nd->n", found, at) > 0
    return np.asarray(np.where(away[:, None], -found, found))


def across(
    pixels: Float[np.ndarray, " n"], mean: float, camera: Camera
) -> Float[np.ndarray, " n"]:
    """Return how far pixels are to the right of a mean: around a panorama the shorter way."""
    if camera.kind != "panorama":
        return pixels - mean
    turn = 2 * np.pi * camera.fx
    return np.asarray((pixels - mean + turn / 2) % turn - turn / 2)

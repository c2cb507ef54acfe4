"""NumPy references of the kernels that draw meshes and layers."""

import numpy as np
from jaxtyping import Float, Float16, Float32, Shaped, UInt32

from gsgen.contract.spec.srgb import srgb_of_linear
from gsgen.runtime.kernels.raster.draw_meshes import AMBIENT_LIGHT
from gsgen.runtime.kernels.raster.mesh_place import TO_LINEAR, TO_SRGB
from gsgen.runtime.kernels.shared.shader import NOWHERE
from gsgen.runtime.playback.image_tiling import Network, run_tiled
from gsgen.runtime.scene.mesh import MeshData


def mesh_reference(
    data: MeshData, uniform: Shaped[np.ndarray, ""], rays: Float32[np.ndarray, "n 2"]
) -> Float[np.ndarray, "h w 8"]:
    """Draw a mesh in float64, as ``draw_meshes.wgsl`` does: RGB, coverage 1, normal, depth.

    ``uniform`` is the result of ``mesh_uniform``, ``rays`` that of ``mesh_rays``.
    """
    width, height = (int(side) for side in uniform["size"])
    ray = _directions(uniform, rays)
    linear = np.asarray(uniform["linear"], np.float64)[:, :3].T
    offset = data.vertices - np.float64(uniform["eye"]) - np.float64(uniform["eye_rest"])
    corners = offset @ linear.T
    image = np.zeros((height, width, 8))
    image[..., 7] = NOWHERE
    for face in data.faces:
        upright = np.cross(corners[face[1]] - corners[face[0]], corners[face[2]] - corners[face[0]])
        size = np.linalg.norm(upright)
        if not size > 0:
            continue
        offsets = np.stack([_offsets(corner, uniform, rays) for corner in corners[face]])
        x, y, z = np.moveaxis(offsets, -1, 0)
        after, last = [1, 2, 0], [2, 0, 1]
        areas = x[after] * y[last] - y[after] * x[last]
        with np.errstate(all="ignore"):
            weights = np.moveaxis(areas / areas.sum(axis=0), 0, -1)
            depth = (weights * np.moveaxis(z, 0, -1)).sum(axis=-1)
            inside = (weights >= 0).all(axis=-1) & (depth > uniform["near"])
        is_nearer = inside & (depth < image[..., 7])
        toward = ray[is_nearer] @ upright / size
        facing = upright / size * np.where(toward > 0, -1, 1)[:, None]
        color = _surface_color(data, face, weights[is_nearer], int(uniform["conversion"]))
        if uniform["shaded"]:
            slant = np.abs(toward) / np.linalg.norm(ray[is_nearer], axis=-1)
            color = color * (AMBIENT_LIGHT + (1 - AMBIENT_LIGHT) * slant)[:, None]
        ones = np.ones((len(color), 1))
        image[is_nearer] = np.concatenate([color, ones, facing, depth[is_nearer][:, None]], -1)
    return image


def _offsets(
    point: Float[np.ndarray, "3"], uniform: Shaped[np.ndarray, ""], rays: Float32[np.ndarray, "n 2"]
) -> Float[np.ndarray, "h w 3"]:
    """Return a point's offsets from each pixel's ray, right and down, and the point's depth."""
    (sine, cosine), (down_sine, down_cosine) = _angles(uniform, rays)
    x, y, z = point
    if uniform["period"]:
        level = sine * x + cosine * z
        right, below = cosine * x - sine * z, down_cosine * y - down_sine * level
        offsets = np.broadcast_arrays(right, below, down_sine * y + down_cosine * level)
    else:
        scale = 1 if uniform["is_flat"] else z
        offsets = np.broadcast_arrays(x - sine * scale, y - down_sine * scale, z)
    return np.stack(offsets, -1)


def _directions(
    uniform: Shaped[np.ndarray, ""], rays: Float32[np.ndarray, "n 2"]
) -> Float[np.ndarray, "h w 3"]:
    """Return each pixel's ray direction of depth 1, so that depth × direction is a point."""
    (x, z), (y, level) = _angles(uniform, rays)
    if uniform["period"]:
        return np.stack(np.broadcast_arrays(x * level, y, z * level), -1)
    slope = 0 if uniform["is_flat"] else 1
    return np.stack(np.broadcast_arrays(slope * x, slope * y, 1.0), -1)


def _angles(
    uniform: Shaped[np.ndarray, ""], rays: Float32[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "2 1 w"], Float[np.ndarray, "2 h 1"]]:
    """Split ray directions into horizontal ones, by pixel column, and vertical ones, by row."""
    width, angles = int(uniform["size"][0]), rays.T.astype(np.float64)
    return angles[:, None, :width], angles[:, width:, None]


def _surface_color(
    data: MeshData, face: UInt32[np.ndarray, "3"], weights: np.ndarray, conversion: int
) -> np.ndarray:
    color = weights @ data.colors[face].astype(np.float64)
    if data.texture is not None and data.uv is not None:
        size = np.array(data.texture.shape[1::-1])
        inside = weights @ data.uv[face].astype(np.float64) % 1
        texels = np.stack([inside[:, 0], 1 - inside[:, 1]], -1) * size - 0.5
        low = np.floor(texels).astype(int)
        sums = np.zeros_like(color)
        for step in ((0, 0), (1, 0), (0, 1), (1, 1)):
            share = np.prod(1 - np.abs(texels - low - step), axis=-1)
            column, row = ((low + step) % size).T
            sums += share[:, None] * data.texture[row, column, :3] / 255
        color = color * sums
    if conversion == TO_LINEAR:
        gamma_encoded = ((color + 0.055) / 1.055) ** 2.4
        return np.asarray(np.where(color <= 0.04045, color / 12.92, gamma_encoded))
    return srgb_of_linear(color) if conversion == TO_SRGB else color


def import_reference(
    picture: Shaped[np.ndarray, ""],
    halves: Float16[np.ndarray, "h r 4"],
    values: Float32[np.ndarray, "h s"],
) -> tuple[Float[np.ndarray, "h w 4"], Float[np.ndarray, "h w"]]:
    """Return an imported layer's colours and depths in float64, as ``import_layer.wgsl`` does.

    Args:
        picture: A ``PICTURE``.
        halves: Linear or encoded colours multiplied by alpha, and alpha; rows may be padded.
        values: The depth buffer.
    """
    width = int(picture["size"][0])
    color, value = halves[:, :width].astype(np.float64), values[:, :width].astype(np.float64)
    alpha = np.clip(color[..., 3:], 0, 1)
    straight_color = np.clip(color[..., :3] / np.maximum(alpha, 1e-6), 0, 1)
    curve = 1.055 * straight_color ** (1 / 2.4) - 0.055
    encoded = np.where(straight_color <= 0.0031308, 12.92 * straight_color, curve)
    with np.errstate(divide="ignore"):
        depth = picture["offset"] / (value + picture["slope"])
    depth = np.where(values[:, :width] == picture["empty"], 0.5 * NOWHERE, depth)
    shown = straight_color if picture["is_encoded"] else encoded
    layer = np.concatenate([alpha * shown, alpha], axis=-1)
    return layer, np.where(alpha[..., 0] > 0, depth, NOWHERE)


def network_reference(
    region: Shaped[np.ndarray, ""],
    image: Float32[np.ndarray, "h w 4"],
    network: Network,
    dtype: type[np.float16 | np.float32],
    overlap: int,
) -> tuple[Float[np.ndarray, "1 c h w"], Float[np.ndarray, "h w 4"]]:
    """Return what a network sees of an image, and the image that it makes of it, in float64.

    The reference of ``image_to_tensor.wgsl`` and ``tensor_to_image.wgsl``, whose uniform is
    ``region``.
    """
    channels, low, high = (region[name].item() for name in ("channels", "low", "high"))
    pixels = image.astype(np.float64)
    alpha = pixels[..., 3:] + (1 - pixels[..., 3:]) * region["background_alpha"]
    alpha = np.clip(alpha, 0, 1)
    straight = np.clip(pixels[..., :3] / np.where(alpha > 0, alpha, 1), 0, 1)
    straight = srgb_of_linear(straight) if region["is_linear"] else straight
    numbers = np.concatenate([straight, alpha], -1)[..., :channels].transpose(2, 0, 1)[None]
    seen = (low + (high - low) * numbers).astype(dtype)
    tile = int(region["tile"][1]), int(region["tile"][0])
    result = run_tiled(seen, network, tile, overlap).astype(np.float64)
    color = ((result - low) / (high - low))[0].transpose(1, 2, 0)
    if color.shape[2] == 4:
        alpha = np.clip(color[..., 3:], 0, 1)
    return seen, np.concatenate([color[..., :3] * alpha, alpha], -1)

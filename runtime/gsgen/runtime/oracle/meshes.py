"""Reference ray caster of meshes: every pixel's ray against every triangle, in float64 NumPy.

It shares neither code nor method with the kernels. They compare a triangle with a ray in two
dimensions, in camera space; here rays in world space intersect planes, and areas on the plane give
the barycentric weights.
"""

__all__ = ["Surface", "cast_rays"]

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Bool, Float

from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.mesh import Mesh

_AMBIENT_LIGHT: Final = 0.2
# Pixels whose surface changes within this offset are fragile: rounding may decide it.
_SAMPLE_OFFSET: Final = 1 / 1024
_SAMPLE_SHIFTS: Final = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * _SAMPLE_OFFSET
_EDGE_THRESHOLD: Final = 1e-2  # least change of colours and normals, and relative change of depths


@final
@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The nearest mesh surface at each pixel.

    Attributes:
        depth: Along the camera's +z, or from a panorama's centre; infinite without a mesh.
        color: Colours in the scene's colour space.
        normal: Unit vectors in world space that point towards the camera.
        fragile: Pixels at an edge of a visible surface, where rounding may decide otherwise.
    """

    depth: Float[np.ndarray, "h w"]
    color: Float[np.ndarray, "h w 3"]
    normal: Float[np.ndarray, "h w 3"]
    fragile: Bool[np.ndarray, "h w"]


def cast_rays(
    meshes: Iterable[Mesh], camera: Camera, color_space: Literal["srgb", "linear"]
) -> Surface:
    """Cast a camera's rays at meshes; return the nearest surfaces, coloured in ``color_space``."""
    start, ray_direction = _camera_rays(camera)
    shape = ray_direction.shape[:3]
    depth = np.full(shape, np.inf)
    color, normal = np.zeros((*shape, 3)), np.zeros((*shape, 3))
    for mesh in meshes:
        matrix = mesh.vertices_to_world
        linear, offset = matrix[:3, :3], matrix[:3, 3]
        corners = (mesh.data.vertices.astype(np.float64) @ linear.T + offset)[
            mesh.data.faces.astype(int)
        ]
        for face, triangle in enumerate(corners):
            rows, columns = _triangle_window(triangle, camera)
            part = (slice(None), rows, columns)
            intersection = _intersect_triangle(
                triangle, start[part], ray_direction[part], camera.near
            )
            if intersection is None:
                continue
            hit_depth, weights, unit_normal = intersection
            is_nearer_hit = hit_depth < depth[part]
            depth[part] = np.where(is_nearer_hit, hit_depth, depth[part])
            facing_cosine = (ray_direction[part] @ unit_normal)[..., None]
            facing_normal = np.where(facing_cosine > 0, -unit_normal, unit_normal)
            normal[part] = np.where(is_nearer_hit[..., None], facing_normal, normal[part])
            mesh_color = _convert_color_space(_color(mesh, face, weights), mesh, color_space)
            if mesh.shading == "headlight":
                length = np.linalg.norm(ray_direction[part], axis=-1, keepdims=True)
                mesh_color = mesh_color * (
                    _AMBIENT_LIGHT + (1 - _AMBIENT_LIGHT) * np.abs(facing_cosine) / length
                )
            color[part] = np.where(is_nearer_hit[..., None], mesh_color, color[part])
    return Surface(depth[0], color[0], normal[0], _edge_pixels(depth, color, normal))


def _camera_rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return origin and direction (of depth 1) of rays at several sub-pixel offsets per pixel."""
    x = np.arange(camera.width) + 0.5 + _SAMPLE_SHIFTS[:, 0, None]
    y = np.arange(camera.height) + 0.5 + _SAMPLE_SHIFTS[:, 1, None]
    shape = (len(_SAMPLE_SHIFTS), camera.height, camera.width)
    column_slopes = np.broadcast_to(((x - camera.cx) / camera.fx)[:, None, :], shape)
    row_slopes = np.broadcast_to(((y - camera.cy) / camera.fy)[:, :, None], shape)
    zeros, ones = np.zeros(shape), np.ones(shape)
    to_world = camera.view[:3, :3]  # rows times R are Rᵀ times columns
    if camera.kind == "orthographic":
        start = np.stack([column_slopes, row_slopes, zeros], -1) @ to_world + camera.eye
        return start, np.stack([zeros, zeros, ones], -1) @ to_world
    start = np.broadcast_to(camera.eye, (*shape, 3))
    if camera.kind == "panorama":  # points of the unit sphere by longitude and latitude
        level = np.cos(row_slopes)
        panorama_directions = [
            level * np.sin(column_slopes),
            np.sin(row_slopes),
            level * np.cos(column_slopes),
        ]
        return start, np.stack(panorama_directions, -1) @ to_world
    return start, np.stack([column_slopes, row_slopes, ones], -1) @ to_world


def _triangle_window(triangle: np.ndarray, camera: Camera) -> tuple[slice, slice]:
    """Return the rows and columns of pixels that a projected triangle may cover."""
    corners = triangle @ camera.view[:3, :3].T + camera.view[:3, 3]
    full_image = slice(0, camera.height), slice(0, camera.width)
    if camera.kind == "panorama":
        return full_image
    if camera.kind == "pinhole":
        if not (corners[:, 2] > 0.5 * camera.near).all():
            return full_image
        corners = corners[:, :2] / corners[:, 2:]
    x = camera.fx * corners[:, 0] + camera.cx
    y = camera.fy * corners[:, 1] + camera.cy
    low = np.clip(np.floor([y.min() - 1, x.min() - 1]), 0, None).astype(int)
    high = np.clip(np.ceil([y.max() + 1, x.max() + 1]), 0, None).astype(int)
    return slice(low[0], high[0]), slice(low[1], high[1])


def _intersect_triangle(
    triangle: np.ndarray, start: np.ndarray, ray_direction: np.ndarray, neighbour_depth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Intersect rays with a triangle: depths (infinite if missed), vertex weights, unit normal."""
    a, b, c = triangle
    area = np.cross(b - a, c - a)
    size = np.linalg.norm(area)
    if not size > 0 or not start.size:
        return None
    unit_normal = area / size
    with np.errstate(all="ignore"):
        distance = ((a - start) @ unit_normal) / (ray_direction @ unit_normal)
        point = start + distance[..., None] * ray_direction
        weights = np.stack(
            [
                np.cross(second - point, third - point) @ unit_normal / size
                for second, third in ((b, c), (c, a), (a, b))
            ],
            -1,
        )
        is_hit_at = (weights >= 0).all(axis=-1) & (distance > neighbour_depth)
    return (
        np.where(is_hit_at, distance, np.inf),
        np.where(is_hit_at[..., None], weights, 0),
        unit_normal,
    )


def _color(mesh: Mesh, face: int, weights: np.ndarray) -> np.ndarray:
    data, corners = mesh.data, mesh.data.faces[face].astype(int)
    color = weights @ data.colors[corners].astype(np.float64)
    if data.texture is None or data.uv is None:
        return np.asarray(color)
    return np.asarray(
        color * _sample_texture(data.texture, weights @ data.uv[corners].astype(float))
    )


def _sample_texture(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Interpolate a repeating texture at coordinates whose origin is its lower left corner."""
    height, width = texture.shape[:2]
    sampled_color = np.zeros((*uv.shape[:-1], 3))
    x, y = uv[..., 0] * width - 0.5, (1 - uv[..., 1]) * height - 0.5
    for right in (0, 1):
        for row_step in (0, 1):
            column, row = np.floor(x) + right, np.floor(y) + row_step
            texel_weight = np.maximum(1 - np.abs(x - column), 0) * np.maximum(
                1 - np.abs(y - row), 0
            )
            color = texture[(row % height).astype(int), (column % width).astype(int), :3]
            sampled_color += texel_weight[..., None] * (color / 255.0)
    return sampled_color


def _convert_color_space(color: np.ndarray, mesh: Mesh, space: str) -> np.ndarray:
    """Convert mesh colours to another colour space (IEC 61966-2-1)."""
    if mesh.data.color_space == space:
        return color
    if space == "linear":
        return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    return np.where(color <= 0.0031308, color * 12.92, 1.055 * color ** (1 / 2.4) - 0.055)


def _edge_pixels(depth: np.ndarray, color: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the pixels whose depth, colour or normal changes if sampled slightly off centre."""
    is_hit = np.isfinite(depth)
    is_edge = (is_hit != is_hit[0]).any(axis=0)
    neighbour_depth = np.where(is_hit, depth, 0)
    is_edge |= (
        np.abs(neighbour_depth - neighbour_depth[0]) > _EDGE_THRESHOLD * neighbour_depth[0]
    ).any(axis=0)
    for image in (color, normal):
        is_edge |= (np.abs(image - image[0]) > _EDGE_THRESHOLD).any(axis=(0, 3))
    return np.asarray(is_edge)

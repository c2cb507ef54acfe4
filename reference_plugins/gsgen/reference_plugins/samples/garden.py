"""A synthetic garden: a table with flowers on a paved circle, lawn, hedge, beds and trees.

The light is baked: the sun with its shadows, the sky, and light that leaves let through.
"""

__all__ = ["apply_lighting", "garden"]

import numpy as np
from jaxtyping import Bool, Float

from gsgen.formats import Splats
from gsgen.formats.shared.quantities import SH_C0, rotations
from gsgen.reference_plugins.samples.surfaces import (
    Cloud,
    Points,
    grass_blades,
    join,
    on_disc,
    on_ellipsoid,
    on_lathe,
)

SUN_DIRECTION = np.array([0.55, 0.75, 0.36])  # towards the sun
_SUN_COLOR, _SKY_COLOR = np.array([1.45, 1.3, 1.02]), np.array([0.36, 0.45, 0.58])
_GROUND_COLOR = np.array([0.16, 0.17, 0.1])
_PAVING_RADIUS, _LAWN_RADIUS = 1.9, 5.2  # radii in metres
_TABLE_HEIGHT, _TABLE_RADIUS = 0.78, 0.8
_HEDGE_RADIUS = 4.7  # radius of the ring in metres
_TREE_POSITIONS = ((-2.6, -3.1, 1.0), (2.5, -3.3, 0.85), (-3.9, 0.9, 0.8))  # x, z, size
_PETAL_COLORS = np.array(
    [[0.95, 0.55, 0.08], [0.9, 0.18, 0.2], [0.93, 0.75, 0.85], [0.55, 0.3, 0.8]]
)
_LOGIT_OPACITY = 3.5  # logit


def garden(count: int = 60_000, *, seed: int = 0) -> Splats:
    """Return a garden of about ``count`` splats, five metres around, with y down as in captures."""
    rng = np.random.default_rng(seed)
    unit = count / 60_000
    cloud = join([*_ground_clouds(unit, rng), *_table_clouds(unit, rng), *_plant_clouds(unit, rng)])
    return apply_lighting(cloud)


def apply_lighting(cloud: Cloud, *, shadows: bool = True) -> Splats:
    """Shade Gaussians by sun and sky, and convert them to splats of SH degree 0, with y down.

    ``shadows`` casts those of the garden's table and trees.
    """
    sun_direction = SUN_DIRECTION / np.linalg.norm(SUN_DIRECTION)
    sun_cosine = cloud.normal @ sun_direction
    diffuse_light = (
        np.maximum(sun_cosine, 0)
        + cloud.translucency * np.maximum(-sun_cosine, 0)
        + 0.3 * cloud.translucency
    )
    if shadows:
        diffuse_light = np.where(
            _is_in_shadow(cloud.position, sun_direction), 0.12 * diffuse_light, diffuse_light
        )
    sky_share = (0.5 + 0.5 * cloud.normal[:, 1])[:, None]
    light = (
        diffuse_light[:, None] * _SUN_COLOR
        + sky_share * _SKY_COLOR
        + (1 - sky_share) * _GROUND_COLOR
    )
    linear_color = cloud.color * light
    display = np.clip(linear_color / (1 + 0.25 * linear_color), 0, 1) ** (1 / 2.2)
    axes = np.stack([cloud.along, np.cross(cloud.normal, cloud.along), cloud.normal], axis=2)
    half_turn = np.array([-1.0, -1.0, 1.0])  # about z: y points down, handedness stays
    return Splats(
        position=(cloud.position * half_turn).astype(np.float32),
        rotation=rotations(axes * half_turn[:, None]),
        log_scale=np.log(cloud.scale).astype(np.float32),
        logit_opacity=np.full(len(cloud), _LOGIT_OPACITY, np.float32),
        sh=((display - 0.5) / SH_C0).astype(np.float32)[:, None],
    )


def _is_in_shadow(
    position: Points, sun_direction: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, " n"]:
    """Return whether the garden's table or a tree shades a point from the sun."""
    # 1. The top is a disc: the ray meets its plane within its radius.
    hit_distance = (_TABLE_HEIGHT - position[:, 1]) / sun_direction[1]
    hit_position = position + hit_distance[:, None] * sun_direction
    shadow = (hit_distance > 0.03) & (
        np.hypot(hit_position[:, 0], hit_position[:, 2]) < _TABLE_RADIUS
    )
    # 2. Crowns are spheres: the ray passes their centre within their radius.
    for x, z, size in _TREE_POSITIONS:
        to_sphere = np.array([x, 2.0 * size, z]) - position
        sun_distance = to_sphere @ sun_direction
        miss_distance = np.linalg.norm(to_sphere - sun_distance[:, None] * sun_direction, axis=1)
        is_inside = np.linalg.norm(to_sphere, axis=1) < 1.05 * size
        shadow |= (sun_distance > 0) & (miss_distance < 0.75 * size) & ~is_inside
    return np.asarray(shadow)


def _ground_clouds(unit: float, rng: np.random.Generator) -> list[Cloud]:
    paving_disc = on_disc(int(11_000 * unit), _PAVING_RADIUS, np.zeros(3))
    x, _, z = paving_disc.position.T
    ring_row, angle = np.hypot(x, z) / 0.32, np.arctan2(z, x)
    row = np.floor(ring_row)
    stones_per_ring = np.maximum(1, np.round(6.3 * (row + 0.5)))
    column = (angle / (2 * np.pi) + 0.37 * row) * stones_per_ring
    edge_distance = np.minimum(np.abs(ring_row % 1 - 0.5), 0.5 - np.abs(column % 1 - 0.5) + 0.4)
    joint = (np.abs(ring_row % 1 - 0.5) > 0.45) | (np.abs(column % 1 - 0.5) > 0.45)
    tone_factor = (
        0.75 + 0.35 * np.modf(np.abs(np.sin(row * 12.99 + np.floor(column) * 78.2) * 43758))[0]
    )
    stone_color = (
        tone_factor[:, None] * np.array([0.5, 0.45, 0.38]) * (0.9 + 0.2 * edge_distance[:, None])
    )
    color_grain_factor = 1 + 0.08 * rng.normal(size=(len(paving_disc), 1))
    color = np.where(joint[:, None], [0.13, 0.14, 0.08], stone_color) * color_grain_factor
    paved_cloud = Cloud(
        position=paving_disc.position,
        normal=paving_disc.normal,
        along=paving_disc.along,
        scale=paving_disc.scale,
        color=color,
        translucency=paving_disc.translucency,
    )
    soil_cloud = on_disc(
        int(7000 * unit), _LAWN_RADIUS, np.array([0.09, 0.15, 0.04]), hole_radius=_PAVING_RADIUS
    )
    count = int(15_000 * unit)
    distance = np.sqrt(rng.uniform(_PAVING_RADIUS**2, _LAWN_RADIUS**2, count))
    turn = rng.uniform(0, 2 * np.pi, count)
    roots = np.stack([distance * np.cos(turn), np.zeros(count), distance * np.sin(turn)], axis=1)
    grass_patches = 0.5 + 0.5 * np.sin(2.1 * roots[:, 0]) * np.sin(1.7 * roots[:, 2] + 1)
    green_color = np.array([0.16, 0.34, 0.05]) + grass_patches[:, None] * np.array(
        [0.13, 0.1, 0.01]
    )
    green_color = green_color * np.exp(0.22 * rng.normal(size=(count, 1)))
    return [
        paved_cloud,
        soil_cloud.moved((0, -0.02, 0)),
        grass_blades(roots, rng.uniform(0.06, 0.15, count), green_color, rng),
    ]


def _table_clouds(unit: float, rng: np.random.Generator) -> list[Cloud]:
    table_top = on_disc(int(4500 * unit), _TABLE_RADIUS, np.zeros(3))
    x, _, z = table_top.position.T
    plank_index = np.floor(x / 0.16)
    color_grain_factor = 0.1 * np.sin(40 * x + 3 * np.sin(5 * z + plank_index)) + 0.06 * rng.normal(
        size=len(table_top)
    )
    tone_factor = (
        0.85 + 0.25 * np.modf(np.abs(np.sin(plank_index * 12.99) * 43758))[0] + color_grain_factor
    )
    is_plank_gap = np.abs(x / 0.16 % 1 - 0.5) > 0.46
    wood = (
        tone_factor[:, None]
        * np.where(is_plank_gap[:, None], 0.25, 1.0)
        * np.array([0.56, 0.33, 0.17])
    )
    table_planks = Cloud(
        position=table_top.position,
        normal=table_top.normal,
        along=table_top.along,
        scale=table_top.scale,
        color=wood,
        translucency=table_top.translucency,
    )
    height, radius = _TABLE_HEIGHT, _TABLE_RADIUS
    brown_color = np.array([0.4, 0.23, 0.12])
    table_rim = on_lathe(int(1200 * unit), [(radius, height - 0.05), (radius, height)], brown_color)
    profile_below = [
        (0.32, 0.0),
        (0.3, 0.05),
        (0.1, 0.12),
        (0.08, 0.5),
        (0.16, 0.7),
        (0.2, height - 0.05),
    ]
    table_foot = on_lathe(int(1500 * unit), profile_below, brown_color)
    vase_outline = [
        (0.09, 0.0),
        (0.15, 0.08),
        (0.17, 0.16),
        (0.12, 0.27),
        (0.08, 0.33),
        (0.1, 0.37),
    ]
    vase = on_lathe(int(1600 * unit), vase_outline, np.array([0.2, 0.42, 0.62]))
    bands = np.sin(vase.position[:, 1] * 70)[:, None] > 0.75
    glazed_vase = Cloud(
        position=vase.position,
        normal=vase.normal,
        along=vase.along,
        scale=vase.scale,
        color=np.where(bands, [0.85, 0.85, 0.8], vase.color),
        translucency=vase.translucency,
    )
    bouquet_flowers = _flower_clouds(int(26 * max(unit, 0.2)), (0.24, 0.17, 0.24), 0.055, rng)
    leaves = on_ellipsoid(int(900 * unit), (0.2, 0.14, 0.2), np.array([0.12, 0.3, 0.07]), rng)
    stand_position = (0.0, height + 0.01, 0.0)
    return [
        table_planks.moved((0, height, 0)),
        table_rim,
        table_foot,
        glazed_vase.moved(stand_position),
        leaves.moved((0, height + 0.47, 0)),
        bouquet_flowers.moved((0, height + 0.52, 0)),
    ]


def _flower_clouds(
    count: int, radii: tuple[float, float, float], size: float, rng: np.random.Generator
) -> Cloud:
    """Return flowers of a heart and two rings of petals, on the upper half of an ellipsoid."""
    flower_clouds = []
    for number in range(count):
        height = 1 - 1.15 * (number + 0.5) / count
        turn = 2.4 * number
        level = np.sqrt(max(0.0, 1 - height**2))
        outward_direction = np.array([level * np.cos(turn), height, level * np.sin(turn)])
        first_axis = np.cross(outward_direction, [0.3, 0.2, 0.9])
        first_axis /= np.linalg.norm(first_axis)
        second_axis = np.cross(outward_direction, first_axis)
        angle = np.linspace(0, 2 * np.pi, 14, endpoint=False)[:, None]
        spoke_direction = np.cos(angle) * first_axis + np.sin(angle) * second_axis
        normal = outward_direction + 0.45 * spoke_direction
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        spoke_tangent = (
            spoke_direction - np.sum(spoke_direction * normal, axis=1, keepdims=True) * normal
        )
        spoke_tangent /= np.linalg.norm(spoke_tangent, axis=1, keepdims=True)
        hue = _PETAL_COLORS[number % len(_PETAL_COLORS)] * rng.uniform(0.8, 1.1)
        petals = Cloud(
            position=outward_direction * radii + 0.55 * size * spoke_direction,
            normal=normal,
            along=spoke_tangent,
            scale=size * np.tile([0.24, 0.14, 0.03], (14, 1)),
            color=hue * rng.uniform(0.85, 1.1, (14, 1)),
            translucency=np.full(14, 0.5),
        )
        flower_center = Cloud(
            position=(outward_direction * radii + 0.12 * size * outward_direction)[None],
            normal=outward_direction[None],
            along=first_axis[None],
            scale=size * np.array([[0.2, 0.2, 0.12]]),
            color=np.array([[0.85, 0.6, 0.1]]),
            translucency=np.zeros(1),
        )
        flower_clouds += [petals, flower_center]
    return join(flower_clouds)


def _plant_clouds(unit: float, rng: np.random.Generator) -> list[Cloud]:
    # 1. The hedge: leaves on a ring with a square profile, open towards +z.
    count = int(11_000 * unit)
    turn = rng.uniform(-1.2 * np.pi, 0.2 * np.pi, count)
    petal_width, height = rng.uniform(-0.3, 0.3, count), 1.15 * rng.random(count)
    grass_blade_side = rng.integers(0, 3, count)
    petal_width = np.where(grass_blade_side == 0, -0.3, petal_width)
    height = np.where(grass_blade_side == 1, 1.15, height)
    distance = _HEDGE_RADIUS + petal_width + 0.05 * rng.normal(size=count)
    spoke_direction = np.stack([np.cos(turn), np.zeros(count), np.sin(turn)], axis=1)
    face = np.where((grass_blade_side == 1)[:, None], [0.0, 1.0, 0.0], -spoke_direction)
    bush_crown_points = on_ellipsoid(
        count, (1.0, 1.0, 1.0), np.array([0.09, 0.24, 0.06]), rng, size=0.042
    )
    normal = face + 0.3 * rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    spoke_tangent = np.cross(normal, bush_crown_points.normal)
    spoke_tangent /= np.linalg.norm(spoke_tangent, axis=1, keepdims=True)
    hedge_leaves = Cloud(
        position=distance[:, None] * spoke_direction + height[:, None] * np.array([0.0, 1.0, 0.0]),
        normal=normal,
        along=spoke_tangent,
        scale=bush_crown_points.scale,
        color=bush_crown_points.color * np.exp(0.3 * rng.normal(size=(count, 1))),
        translucency=bush_crown_points.translucency,
    )
    clouds = [hedge_leaves]
    # 2. Trees: a trunk and a crown of leaves.
    for x, z, size in _TREE_POSITIONS:
        trunk_cloud = on_lathe(
            int(350 * unit), [(0.09, 0), (0.06, 0.8), (0.05, 1.6)], np.array([0.2, 0.14, 0.09])
        )
        tone_factor = np.array([0.17, 0.36, 0.06]) * rng.uniform(0.8, 1.15)
        crown_cloud = on_ellipsoid(
            int(3000 * unit), (size, 0.85 * size, size), tone_factor, rng, depth=0.5, size=0.045
        )
        clouds += [trunk_cloud.moved((x, 0, z)), crown_cloud.moved((x, 2.0 * size, z))]
    # 3. Beds: low bushes with flowers, around the paving.
    for number in range(7):
        bed_angle = np.pi * (0.95 + 1.1 * number / 6)
        x, z = 2.75 * np.cos(bed_angle), 2.75 * np.sin(bed_angle)
        bush_leaf_points = on_ellipsoid(
            int(600 * unit), (0.38, 0.3, 0.38), np.array([0.12, 0.28, 0.08]), rng, size=0.025
        )
        bloom_cloud = _flower_clouds(int(15 * max(unit, 0.2)), (0.4, 0.32, 0.4), 0.06, rng)
        clouds += [bush_leaf_points.moved((x, 0.15, z)), bloom_cloud.moved((x, 0.17, z))]
    return clouds

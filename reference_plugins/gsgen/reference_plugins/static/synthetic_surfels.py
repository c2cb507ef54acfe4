"""Writes synthetic checkpoints of 2DGS: discs on the surface of a torus."""

__all__ = ["write_surfels"]

from pathlib import Path

import numpy as np

from gsgen.contract.spec.spherical_harmonics import coefficients
from gsgen.formats import Splats
from gsgen.formats.shared.quantities import SH_C0
from gsgen.reference_plugins.writing.run_files import splat_columns, write_cfg_args, write_columns

_RING_RADIUS, _TUBE_RADIUS = 1.0, 0.45


def write_surfels(folder: Path, *, count: int = 64, degree: int = 3, seed: int = 0) -> Path:
    """Write a synthetic checkpoint of 2DGS, and return the folder.

    The discs cover a torus three units wide, in stripes of two colours.
    """
    rng = np.random.default_rng(seed)
    ring_angle, tube_angle = rng.uniform(0, 2 * np.pi, (2, count))
    outward_direction = np.stack([np.cos(ring_angle), np.zeros(count), np.sin(ring_angle)], axis=1)
    normal = np.cos(tube_angle)[:, None] * outward_direction + np.sin(tube_angle)[:, None] * [
        0.0,
        1.0,
        0.0,
    ]
    position = _RING_RADIUS * outward_direction + _TUBE_RADIUS * normal
    # The quaternion that turns z to the normal, after a random turn around z.
    tilt_quaternion = np.stack(
        [1 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(count)], axis=1
    )
    tilt_quaternion[:, 0] += 1e-3  # normals along −z
    half_angle = rng.uniform(0, np.pi, count)
    w, x, y, _ = tilt_quaternion.T
    cos, sin = np.cos(half_angle), np.sin(half_angle)
    rotation = np.stack([w * cos, x * cos + y * sin, y * cos - x * sin, w * sin], axis=1)
    size = 4.0 * np.sqrt(_RING_RADIUS * _TUBE_RADIUS / count)
    stripe_mask = (np.sin(5 * ring_angle + 3 * tube_angle) > 0)[:, None]
    color = np.where(stripe_mask, [0.9, 0.55, 0.2], [0.15, 0.4, 0.65])
    sh = np.zeros((count, coefficients(degree), 3))
    sh[:, 0] = (color + 0.05 * rng.normal(size=(count, 3)) - 0.5) / SH_C0
    sh[:, 1:] = 0.02 * rng.normal(size=sh[:, 1:].shape)
    splats = Splats(
        position=position.astype(np.float32),
        rotation=rotation.astype(np.float32),
        log_scale=(np.log(size) + 0.3 * rng.normal(size=(count, 3))).astype(np.float32),
        logit_opacity=rng.normal(2.5, 0.8, count).astype(np.float32),
        sh=sh.astype(np.float32),
    )
    columns = splat_columns(splats)
    del columns["scale_2"]
    write_cfg_args(folder, {"sh_degree": degree})
    write_columns(folder / "point_cloud/iteration_30000/point_cloud.ply", columns)
    return folder

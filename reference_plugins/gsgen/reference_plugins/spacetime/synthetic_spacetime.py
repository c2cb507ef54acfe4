"""Writes synthetic checkpoints of SpacetimeGaussians, as its training code does.

The Gaussians are a torus knot. Each swings around its place, appears and fades.
"""

__all__ = ["write_spacetime"]

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from gsgen.formats.shared.quantities import SH_C0
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.reference_plugins.writing.run_files import write_cfg_args, write_columns

_ITERATION_NUMBER = 25_000


def write_spacetime(
    folder: Path, *, count: int = 64, full: bool = False, sway: float = 0.5, seed: int = 0
) -> Path:
    """Write a synthetic checkpoint of SpacetimeGaussians, and return the folder.

    ``full`` adds features and their decoder; ``sway`` is the approximate movement, of a knot that
    is three units wide.
    """
    rng = np.random.default_rng(seed)
    knot_splats = torus_knot(count, degree=0, seed=seed)
    color = 0.5 + SH_C0 * knot_splats.sh[:, 0]
    # Splats appear one after another along the knot. Each fourth lasts as long as the scene.
    centre = np.linspace(0, 1, count)[:, None]
    log_duration = np.where(np.arange(count)[:, None] % 4, rng.normal(-1.2, 0.2, (count, 1)), 1.0)
    columns = dict(zip("xyz", knot_splats.position.T, strict=True))
    columns |= {"trbf_center": centre[:, 0], "trbf_scale": log_duration[:, 0]}
    columns |= dict.fromkeys(("nx", "ny", "nz"), np.zeros(count))
    columns |= _numbered_columns("motion", _motion_coefficients(knot_splats.position, sway))
    features = [color, rng.normal(0, 0.5, (count, 3))] if full else [color]
    columns |= _numbered_columns("f_dc", np.concatenate(features, axis=1))
    columns |= {"opacity": knot_splats.logit_opacity}
    columns |= _numbered_columns("scale", knot_splats.log_scale) | _numbered_columns(
        "rot", knot_splats.rotation
    )
    columns |= _numbered_columns("omega", rng.normal(0, 0.1, (count, 4)))
    if full:
        columns |= _numbered_columns("f_t", rng.normal(0, 0.5, (count, 3)))
    variant_name = "ours_full" if full else "ours_lite"
    function = "sandwich" if full else "rgbv1"
    write_cfg_args(folder, {"model": variant_name, "rgbfunction": function, "duration": 50})
    cloud = folder / f"point_cloud/iteration_{_ITERATION_NUMBER}/point_cloud.ply"
    write_columns(cloud, columns)
    if full:
        noise = torch.Generator().manual_seed(seed)
        state = {
            "mlp1.weight": torch.randn((6, 12, 1, 1), generator=noise) / 12**0.5,
            "mlp2.weight": torch.randn((3, 6, 1, 1), generator=noise) / 6**0.5,
        }
        torch.save(state, cloud.with_suffix(".pt"))
    return folder


def _motion_coefficients(
    position: Float[np.ndarray, "n 3"], sway: float
) -> Float[np.ndarray, "n 9"]:
    """Return the coefficients of a motion that lifts points and turns them around the axis y."""
    x, _, z = position.T
    phase = np.arctan2(z, x)
    linear_motion = np.stack([z, np.sin(2 * phase), -x], axis=1)
    quadratic = np.stack([-x, np.cos(3 * phase), -z], axis=1)
    cubic_motion = -0.5 * linear_motion
    return sway * np.concatenate([linear_motion, quadratic, cubic_motion], axis=1)


def _numbered_columns(
    name: str, table: Float[np.ndarray, "n k"]
) -> dict[str, Float[np.ndarray, " n"]]:
    """Return an array's columns by PLY property name, which is a prefix and the column number."""
    return {f"{name}_{index}": column for index, column in enumerate(table.T)}

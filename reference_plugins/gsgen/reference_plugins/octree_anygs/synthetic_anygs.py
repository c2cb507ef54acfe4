"""Writes synthetic checkpoints of Octree-AnyGS, in the layout of its training code."""

__all__ = ["write_anygs"]

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gsgen.reference_plugins.anchors.synthetic_anchors import (
    AnchorOptions,
    anchor_columns,
    write_networks,
)
from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.reference_plugins.writing.run_files import splat_columns, write_cfg_args, write_columns


def write_anygs(
    folder: Path,
    options: AnchorOptions = AnchorOptions(iteration=40000),  # noqa: B008
    *,
    base: str = "scaffoldgs",
    count: int = 64,
    degree: int = 3,
    levels: int = 3,
    mode: str = "round",
    fork: int = 2,
    distance: float = 6.0,
) -> Path:
    """Write a synthetic checkpoint of Octree-AnyGS, and return the folder.

    Args:
        folder: The training run.
        options: Sizes of anchors and networks, for the base model ``scaffoldgs``.
        base: The base model: scaffoldgs, 3dgs or 2dgs.
        count: Number of explicit Gaussians.
        degree: SH degree of explicit Gaussians.
        levels: Levels of detail; 0 for a model without.
        mode: Rounds levels: round, floor, ceil or progressive.
        fork: Ratio of the cell sizes of two levels.
        distance: Belongs to level 0.
    """
    rng = np.random.default_rng(options.seed)
    files = folder / "point_cloud" / f"iteration_{options.iteration}"
    is_neural = base == "scaffoldgs"
    if is_neural:
        columns, kwargs = _anchors(options, rng)
    else:
        columns, kwargs = _explicit_columns(count, degree, rng)
    infos: tuple[str, ...] = ()
    if levels:
        level = rng.integers(0, levels, len(columns["x"]))
        level[:2] = 0, levels - 1
        extra_levels = rng.normal(0, 0.3, len(level))
        xyz = {axis: columns.pop(axis) for axis in "xyz"}
        columns = xyz | {"level": level, "extra_level": extra_levels} | columns
        infos = (f"standard_dist {distance:.6f}", f"levels {levels:.6f}")
        kwargs |= {"fork": fork, "dist2level": mode, "levels": -1, "init_level": -1}
        kwargs |= {"progressive": True, "base_layer": 11, "visible_threshold": 0.9}
    name = "GaussianLoDModel" if levels else "GaussianModel"
    cfg = {
        "model_config": {"name": name, "kwargs": kwargs},
        "base_model": base,
        "dataset_name": "synthetic",
        "resolution_scales": [1.0],
        "render_mode": "RGB",
    }
    write_cfg_args(folder, cfg)
    (folder / "config.yaml").write_text(json.dumps({"model_params": cfg}), "utf-8")  # JSON is YAML
    write_columns(files / "point_cloud.ply", columns, infos)
    if is_neural:
        write_networks(files, options)
    return folder


PlyColumns = dict[str, Float[np.ndarray, " n"]]


def _anchors(
    options: AnchorOptions, rng: np.random.Generator
) -> tuple[PlyColumns, dict[str, object]]:
    columns = anchor_columns(options, rng)
    del columns["opacity"]
    kwargs: dict[str, object] = {
        "feat_dim": options.width,
        "view_dim": options.direction,
        "appearance_dim": options.appearance,
        "n_offsets": options.per_anchor,
        "use_feat_bank": options.has_feature_bank,
    }
    return columns, kwargs


def _explicit_columns(
    count: int, degree: int, rng: np.random.Generator
) -> tuple[PlyColumns, dict[str, object]]:
    """Return Gaussians along a torus knot, moved by their anchor offsets."""
    columns = splat_columns(torus_knot(count, degree=degree))
    offset, extents = rng.normal(0, 1, (3, count)), rng.normal(-4, 0.3, (3, count))
    scale = {f"scale_{axis + 3}": columns[f"scale_{axis}"] + 0.7 for axis in range(3)}
    scale = {f"scale_{axis}": extents[axis] for axis in range(3)} | scale
    offset_columns = {f"f_offset_{axis}": offset[axis] for axis in range(3)}
    colors = {name: columns[name] for name in columns if name.startswith(("f_", "opacity"))}
    xyz = {axis: columns[axis] for axis in "xyz"}
    rotation = {f"rot_{index}": columns[f"rot_{index}"] for index in range(4)}
    kwargs: dict[str, object] = {"max_sh_degree": degree, "n_offsets": 1}
    return xyz | offset_columns | colors | scale | rotation, kwargs

"""Writes synthetic checkpoints of anchor methods, in the layout of their training code.

Anchors lie along a torus knot. Most weights are noise, but the first numbers of a feature determine
the colour, and most opacities are high, so that pictures show a coloured knot.
"""

__all__ = [
    "AnchorOptions", "anchor_columns", "write_duplex", "write_networks", "write_octree", "write_scaffold",
]  # fmt: skip

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.reference_plugins.writing.run_files import write_cfg_args, write_columns

_CHANNELS_BY_HEAD = {"opacity_mlp": 1, "cov_mlp": 7, "color_mlp": 3}
_HUE_COUNT = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorOptions:
    """Sizes and options of a synthetic checkpoint of an anchor-based method."""

    anchors: int = 64  # number of anchors
    per_anchor: int = 5  # Gaussians of an anchor
    width: int = 16  # length of a feature vector, a multiple of 4
    direction: int = 3  # inputs for the direction of the camera: 3, or 0 (Octree-AnyGS)
    has_feature_bank: bool = False  # mix features of three resolutions by a feature bank
    # whether the distance is an input of the opacity, covariance and colour networks
    distance: tuple[bool, bool, bool] = (False, False, False)
    level: bool = False  # whether the level is an input of all networks (Octree-GS)
    cameras: int = 0  # training cameras, each with an appearance
    appearance: int = 0  # length of an appearance vector; 0 for no appearances
    is_single_file: bool = False  # write all networks to one file of state dicts
    iteration: int = 30000  # number of the iteration
    seed: int = 0  # seed of all random numbers


def write_scaffold(folder: Path, options: AnchorOptions = AnchorOptions()) -> Path:
    """Write a synthetic checkpoint of Scaffold-GS, and return the folder."""
    rng = np.random.default_rng(options.seed)
    columns = _knot_positions(options) | {
        axis: np.zeros(options.anchors) for axis in ("nx", "ny", "nz")
    }
    columns |= _anchor_columns(options, rng)
    cfg = _cfg_values(options) | {"voxel_size": 0.001, "lod": 0, "sh_degree": 3}
    _write_training_run(folder, options, columns, cfg)
    return folder


def write_octree(
    folder: Path,
    options: AnchorOptions = AnchorOptions(iteration=40000),
    *,
    mode: str = "round",
    fork: int = 2,
    levels: int = 3,
    distance: float = 6.0,
) -> Path:
    """Write a synthetic checkpoint of Octree-GS, and return the folder.

    ``mode`` rounds levels: round, floor, ceil or progressive. ``fork`` is the ratio of the cell
    sizes of two levels, and ``distance`` belongs to level 0.
    """
    rng = np.random.default_rng(options.seed)
    columns = (
        _knot_positions(options) | _levels(options, levels, rng) | _anchor_columns(options, rng)
    )
    columns["info"][1] = distance
    _write_training_run(
        folder, options, columns, _cfg_values(options) | _level_cfg_values(options, mode, fork)
    )
    return folder


def write_duplex(
    folder: Path,
    options: AnchorOptions = AnchorOptions(iteration=40000),
    *,
    mode: str = "round",
    fork: int = 2,
    levels: int = 3,
    degree: int = 3,
    sigma: float = 9.0,
    depth: bool = True,
) -> Path:
    """Write a synthetic checkpoint of Duplex-GS, and return the folder.

    ``mode``, ``fork`` and ``levels`` are as in :func:`write_octree`; ``degree`` is the SH degree of
    the visibility, and weights fall to 0 at the depth ``sigma`` if ``depth``.
    """
    rng = np.random.default_rng(options.seed)
    n = options.anchors
    columns = _knot_positions(options) | _levels(options, levels, rng)
    columns["info"][2:5] = sigma, 0.05, 1.0  # sigma, background weight, transmittance grade
    dropped_columns = ("opacity", "scale_", "rot_")
    payload = _anchor_columns(options, rng)
    columns |= {name: payload[name] for name in payload if not name.startswith(dropped_columns)}
    columns |= {f"anchor_size_{i}": rng.normal(-2.2, 0.3, n) for i in range(3)}
    columns |= {f"anchor_rot_{i}": rng.normal(0, 1, n) for i in range(4)}
    columns["anchor_shd_0"] = rng.normal(6, 1, n)
    indices = range((degree + 1) ** 2 - 1)
    columns |= {f"anchor_shv_{i}": rng.normal(0, 0.5, n) for i in indices}
    cfg = _cfg_values(options) | _level_cfg_values(options, mode, fork)
    cfg |= {"max_sh_degree": degree, "depth_correct": depth, "add_vi_dist": False}
    _write_training_run(folder, options, columns, cfg | {"ET_grade": 2.0, "ET_grade_final": 1.0})
    return folder


def _levels(
    options: AnchorOptions, levels: int, rng: np.random.Generator
) -> dict[str, Float[np.ndarray, " n"]]:
    n = options.anchors
    level = rng.integers(0, levels, n)
    level[:2] = 0, levels - 1
    info = np.zeros(n)
    info[:2] = 0.2, 6.0  # voxel size, and the distance of level 0
    return {"level": level, "extra_level": rng.normal(0, 0.3, n), "info": info}


def _level_cfg_values(options: AnchorOptions, mode: str, fork: int) -> dict[str, object]:
    cfg = {"fork": fork, "dist2level": mode, "add_level": options.level}
    return cfg | {"progressive": True, "resolution_scales": [1.0], "base_layer": 5}


def anchor_columns(
    options: AnchorOptions, rng: np.random.Generator
) -> dict[str, Float[np.ndarray, " n"]]:
    """Return the PLY columns of anchors along a torus knot, without levels of detail."""
    return _knot_positions(options) | _anchor_columns(options, rng)


def _knot_positions(options: AnchorOptions) -> dict[str, Float[np.ndarray, " n"]]:
    knot_splats = torus_knot(options.anchors, degree=0, seed=options.seed)
    return dict(zip("xyz", knot_splats.position.T, strict=True))


def _anchor_columns(
    options: AnchorOptions, rng: np.random.Generator
) -> dict[str, Float[np.ndarray, " n"]]:
    """Return the PLY columns of anchors: offsets (axis by axis), features, scales, rotations."""
    n, k = options.anchors, options.per_anchor
    offset = rng.normal(0, 1, (n, k, 3)).transpose(0, 2, 1).reshape(n, 3 * k)
    feature = rng.normal(0, 0.5, (n, options.width))
    hue = torus_knot(n, degree=0, seed=options.seed).sh[:, 0]
    feature[:, :_HUE_COUNT] = 1 + hue / np.abs(hue).max()
    scale = np.concatenate([rng.normal(-3, 0.3, (n, 3)), rng.normal(-2.5, 0.3, (n, 3))], axis=1)
    rotation = rng.normal(0, 1, (n, 4))
    columns = {f"f_offset_{i}": offset[:, i] for i in range(3 * k)}
    columns |= {f"f_anchor_feat_{i}": feature[:, i] for i in range(options.width)}
    columns["opacity"] = np.full(n, 0.1)
    columns |= {f"scale_{i}": scale[:, i] for i in range(6)}
    return columns | {f"rot_{i}": rotation[:, i] for i in range(4)}


def _cfg_values(options: AnchorOptions) -> dict[str, object]:
    opacity, covariance, color = options.distance
    return {
        "feat_dim": options.width,
        "n_offsets": options.per_anchor,
        "use_feat_bank": options.has_feature_bank,
        "appearance_dim": options.appearance,
        "add_opacity_dist": opacity,
        "add_cov_dist": covariance,
        "add_color_dist": color,
    }


def _write_training_run(
    folder: Path,
    options: AnchorOptions,
    columns: Mapping[str, np.ndarray],
    cfg: Mapping[str, object],
) -> None:
    iteration_folder = folder / "point_cloud" / f"iteration_{options.iteration}"
    write_cfg_args(folder, cfg)
    write_columns(iteration_folder / "point_cloud.ply", columns)
    write_networks(iteration_folder, options, octree="level" in columns)


def write_networks(iteration_folder: Path, options: AnchorOptions, *, octree: bool = True) -> None:
    """Write random networks of an anchor method; with ``octree``, as Octree-GS has them."""
    networks = _networks(options, octree=octree)
    if options.is_single_file:
        is_single_file = {
            {"embedding_appearance": "appearance"}.get(name, name): network.state_dict()
            for name, network in networks.items()
        }
        torch.save(is_single_file, iteration_folder / "checkpoints.pth")
        return
    for name, network in networks.items():
        _save_script(network, iteration_folder / f"{name}.pt")


def _networks(options: AnchorOptions, *, octree: bool) -> dict[str, nn.Module]:
    generator = torch.Generator().manual_seed(options.seed)
    input_size = options.width + options.direction + options.level
    networks: dict[str, nn.Module] = {}
    for index, (name, outputs) in enumerate(_CHANNELS_BY_HEAD.items()):
        inputs = input_size + options.distance[index]
        inputs += options.appearance if name == "color_mlp" else 0
        head = _make_network(inputs, options.width, outputs * options.per_anchor, generator)
        _shape_head(name, head, options.per_anchor)
        networks[name] = head
    if options.has_feature_bank:
        inputs = 3 + options.level if octree else 4
        networks["feature_bank_mlp"] = _make_network(inputs, options.width, 3, generator)
    if options.appearance:
        networks["embedding_appearance"] = _Embedding(options, generator)
    return networks


class _Embedding(nn.Module):
    """Wraps an appearance embedding in a module, as the training code of Scaffold-GS does."""

    def __init__(self, options: AnchorOptions, generator: torch.Generator) -> None:
        super().__init__()
        self.embedding = nn.Embedding(options.cameras, options.appearance)
        with torch.no_grad():
            self.embedding.weight.normal_(generator=generator)

    def forward(self, index: Tensor) -> Tensor:
        rows: Tensor = self.embedding(index)
        return rows


def _make_network(
    inputs: int, width: int, outputs: int, generator: torch.Generator
) -> nn.Sequential:
    network = nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, outputs))
    with torch.no_grad():
        for parameter in network.parameters():
            weight_deviation = 1.0 / max(1, parameter.shape[-1]) ** 0.5
            parameter.normal_(0, weight_deviation, generator=generator)
    return network


def _shape_head(name: str, head: nn.Sequential, per_anchor: int) -> None:
    """Set a decoding network's weights: colour follows the feature's hue, and opacity is high."""
    first, last = head[0], head[2]
    assert isinstance(first, nn.Linear)
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        if name == "opacity_mlp":
            last.bias.add_(0.7)
        if name == "color_mlp":
            first.weight[:_HUE_COUNT] *= 0.1
            first.weight[:_HUE_COUNT, :_HUE_COUNT] += torch.eye(_HUE_COUNT)
            last.weight[:, :_HUE_COUNT] += 3 * torch.eye(_HUE_COUNT).repeat(per_anchor, 1)
            last.bias.sub_(3)


def _save_script(network: nn.Module, path: Path) -> None:
    """Save a network as TorchScript by tracing, as the training code of Scaffold-GS does."""
    example: Tensor
    if isinstance(network, nn.Sequential):
        first = network[0]
        assert isinstance(first, nn.Linear)
        example = torch.zeros(1, first.in_features)
    else:
        example = torch.zeros(1, dtype=torch.long)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch.jit.trace is deprecated
        traced_network = torch.jit.trace(network.eval(), example)  # type: ignore[no-untyped-call]
        traced_network.save(str(path))

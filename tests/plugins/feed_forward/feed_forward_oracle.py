"""What Splatter Image and LGM compute from pictures, in float64 with NumPy and SciPy."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from safetensors.torch import load_file
from scipy.spatial.transform import Rotation

from plugins.feed_forward.network_oracle import State, convolve, multi_view_unet, song_unet
from support.checkpoints.plugin_oracles import ExpectedGaussians


def splatter_image(
    folder: Path, image: np.ndarray, views: np.ndarray, focals: np.ndarray | None = None
) -> ExpectedGaussians:
    """Return the Gaussians of Splatter Image; ``views`` are world to camera, [v, 4, 4]."""
    config = yaml.safe_load((folder / ".hydra" / "config.yaml").read_text("utf-8"))
    saved = torch.load(folder / "model_latest.pth", weights_only=True)["model_state_dict"]
    data, model = config["data"], config["model"]
    name = "network_with_offset" if model["network_with_offset"] else "network_wo_offset"
    network = part_of(saved, f"{name}.encoder.")
    to_world = np.linalg.inv(views.astype(np.float64))
    features = song_unet(network, image.astype(np.float64), _pose_code(config, to_world))
    features = convolve(part_of(saved, f"{name}."), "out", features)
    columns = iter(features.reshape(*features.shape[:2], -1).transpose(0, 2, 1).transpose(2, 0, 1))

    def take(count: int) -> np.ndarray:
        return np.stack([next(columns) for _ in range(count)], axis=-1)

    rays = saved["ray_dirs"].numpy().astype(np.float64).reshape(3, -1).T
    rows: list[tuple[np.ndarray, ...]] = []
    depth = data["znear"] + (data["zfar"] - data["znear"]) / (1 + np.exp(-take(1)))
    offset = take(3) if model["network_with_offset"] else 0.0
    opacity = 1 / (1 + np.exp(-take(1)))
    scale, rotation, constant = np.exp(take(3)), take(4), take(3)
    rest = take(9) if model["max_sh_degree"] else None
    if model["isotropic"]:
        scale = scale[..., :1].repeat(3, axis=-1)
    for number, matrix in enumerate(to_world):
        turn, center = matrix[:3, :3], matrix[:3, 3]
        directions = rays.copy()
        if focals is not None:
            directions[:, :2] /= focals[number]
        distance = -center @ turn[:, 2] if data["origin_distances"] else 0.0
        shift = offset[number] if isinstance(offset, np.ndarray) else offset
        position = (directions * (depth[number] + distance) + shift) @ turn.T + center
        # SciPy has the scalar last.
        local = Rotation.from_quat(rotation[number][:, [1, 2, 3, 0]]).as_matrix()
        matrices = turn @ local
        sigma = matrices @ (scale[number][:, :, None] ** 2 * matrices.transpose(0, 2, 1))
        upper = sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        color = constant[number]
        if rest is not None:
            # Degree 1 is −y, z, −x of a vector, for red, green and blue.
            harmonics = rest[number].reshape(-1, 3, 3)
            vectors = np.stack([-harmonics[:, 2], -harmonics[:, 0], harmonics[:, 1]], axis=1)
            turned = turn @ vectors
            turned = np.stack([-turned[:, 1], turned[:, 2], -turned[:, 0]], axis=1)
            color = np.concatenate([color, turned.reshape(-1, 9)], axis=1)
        rows.append((position, opacity[number][:, 0], upper, color))
    return _expected(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))


def _pose_code(config: dict[str, Any], to_world: np.ndarray) -> np.ndarray | None:
    """Return the sines and cosines of each camera's centre and axis, seen by the first camera."""
    if config["cam_embd"]["embedding"] is None:
        return None
    half = config["cam_embd"]["dimension"] // 2
    relative = np.linalg.inv(to_world[0]) @ to_world
    numbers = np.concatenate([relative[:, :3, 3], relative[:, :3, 2]], axis=1)
    angles = numbers[:, :, None] * (1 / 10000) ** (np.arange(half) / half)
    code = np.concatenate([np.cos(angles), np.sin(angles)], axis=2).reshape(len(to_world), -1)
    return np.roll(code, code.shape[1] // 2, axis=1)


def lgm(folder: Path, image: np.ndarray) -> ExpectedGaussians:
    """Return the Gaussians of LGM for its four pictures, [4, 3, h, w]."""
    saved = load_file(folder / "model.safetensors")
    mean, deviation = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
    colors = (image - np.reshape(mean, (3, 1, 1))) / np.reshape(deviation, (3, 1, 1))
    features = np.concatenate([colors, _plucker(image.shape[-1])], axis=1)
    features = convolve(
        part_of(saved, ""), "conv", multi_view_unet(part_of(saved, "unet."), features)
    )
    rows = features.transpose(0, 2, 3, 1).reshape(-1, 14)
    rotation = Rotation.from_quat(rows[:, [8, 9, 10, 7]])
    axes = rotation.as_matrix() * (0.1 * np.logaddexp(0, rows[:, None, 4:7]))
    sigma = axes @ axes.transpose(0, 2, 1)
    return _expected(
        np.clip(rows[:, :3], -1, 1),
        1 / (1 + np.exp(-rows[:, 3])),
        sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]],
        0.5 * np.tanh(rows[:, 11:]) + 0.5,
    )


def _plucker(side: int) -> np.ndarray:
    """Return moment and direction of each pixel's ray, for cameras on a circle around +y."""
    focal = side / 2 / np.tan(np.radians(49.1) / 2)
    columns, lines = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5)
    local = np.stack(
        [(columns - side / 2) / focal, -(lines - side / 2) / focal, -np.ones((side, side))], axis=-1
    )
    rays = []
    for azimuth in (0, 90, 180, 270):
        turn = Rotation.from_euler("y", azimuth, degrees=True).as_matrix()
        direction = local @ turn.T
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        moment = np.cross(turn @ [0, 0, 1.5], direction)
        rays.append(np.concatenate([moment, direction], axis=-1).transpose(2, 0, 1))
    return np.stack(rays)


def part_of(state: dict[str, torch.Tensor], prefix: str) -> State:
    """Return the tensors below a prefix as float64 arrays."""
    return {
        name.removeprefix(prefix): value.numpy().astype(np.float64)
        for name, value in state.items()
        if name.startswith(prefix)
    }


def _expected(
    position: np.ndarray, opacity: np.ndarray, covariance: np.ndarray, color: np.ndarray
) -> ExpectedGaussians:
    return ExpectedGaussians(
        retained=np.ones(len(position), bool),
        position=position,
        opacity=opacity,
        covariance=covariance,
        color=color,
    )

"""What SC-GS computes, Gaussian by Gaussian in float64; the files are read here by themselves."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import torch

from support.checkpoints.plugin_oracles import ExpectedGaussians
from support.checkpoints.spacetime_oracles import raw_columns, rotation_matrix, upper


def _encoded(values: np.ndarray, octaves: int) -> np.ndarray:
    parts = [values]
    for octave in range(octaves):
        parts += [np.sin(values * 2.0**octave), np.cos(values * 2.0**octave)]
    return np.concatenate(parts)


def _moved_nodes(
    state: dict[str, np.ndarray], time: float, options: dict[str, Any]
) -> list[dict[str, np.ndarray]]:
    """Return what the heads of the network give for each node."""

    def layer(name: str, x: np.ndarray) -> np.ndarray:
        y: np.ndarray = state[f"network.{name}.weight"] @ x + state[f"network.{name}.bias"]
        return y

    moved: list[dict[str, np.ndarray]] = []
    for node in state["nodes"]:
        blender = options.get("is_blender", True)
        moment = _encoded(np.array([time]), 6 if blender else 10)
        if blender:
            moment = layer("timenet.2", np.maximum(layer("timenet.0", moment), 0))
        embedded = np.concatenate([_encoded(node[:3], 10), moment])
        hidden = embedded
        for index in range(8):
            hidden = np.maximum(layer(f"linear.{index}", hidden), 0)
            if index == 4:
                hidden = np.concatenate([embedded, hidden])
        heads = {
            "warp": layer("gaussian_warp", hidden),
            "scaling": layer("gaussian_scaling", hidden),
            "rotation": layer("gaussian_rotation", hidden),
        }
        if options.get("max_d_scale", -1) > 0:
            heads["scaling"] = np.tanh(heads["scaling"]) * np.log(options["max_d_scale"])
        if options.get("local_frame"):
            heads["local"] = layer("local_rotation", hidden)
        if options.get("pred_opacity"):
            heads["opacity"] = layer("gaussian_opacity", hidden)
        if options.get("pred_color"):
            value = np.concatenate([embedded, hidden])
            for index in (0, 2, 4):
                value = layer(f"gaussian_color.{index}", value)
                value = np.maximum(value, 0) if index < 4 else value
            heads["color"] = value
        moved.append(heads)
    return moved


def control_nodes(folder: Path, time: float, options: dict[str, Any]) -> ExpectedGaussians:
    """SC-GS (Huang et al. 2024, equations 3 to 6; `utils/time_utils.py`)."""
    (deform,) = folder.rglob("deform.pth")
    state = {n: v.double().numpy() for n, v in torch.load(deform, weights_only=True).items()}
    (cloud,) = folder.rglob("point_cloud.ply")
    columns = raw_columns(cloud)

    def table(name: str) -> np.ndarray:
        matches = [c for c in columns if re.fullmatch(rf"{name}_\d+", c)]
        names = sorted(matches, key=lambda c: int(c.rsplit("_", 1)[1]))
        empty = np.zeros((len(columns["x"]), 0))
        return np.stack([columns[n] for n in names], axis=1) if names else empty

    nodes, moved = state["nodes"], _moved_nodes(state, time, options)
    features, size = table("fea"), nodes.shape[1] - 3
    identity = np.array([1.0, 0, 0, 0])
    residual = options.get("d_rot_as_res", True) and not options.get("d_rot_as_rotmat", False)
    rows: dict[str, list] = {name: [] for name in ("position", "opacity", "covariance", "color")}
    for row in range(len(features)):
        x = np.array([columns[axis][row] for axis in "xyz"])
        mask = 1.0
        if options.get("gs_with_motion_mask"):
            mask = 1 / (1 + np.exp(-features[row, -1]))
        square = ((np.concatenate([x, features[row, :size]]) - nodes) ** 2).sum(axis=1)
        nearest = np.argsort(square)[: options.get("K", 3)]
        radius = np.exp(state["_node_radius"][nearest])
        share = 1 / (1 + np.exp(-state["_node_weight"][nearest, 0]))
        weight = np.exp(-square[nearest] / (2 * radius**2)) * share + 1e-7
        pairs = list(zip(weight / weight.sum(), nearest, strict=True))

        def blend(name: str, pairs: list = pairs) -> np.ndarray:
            return np.asarray(sum(w * moved[j][name] for w, j in pairs))

        shift = blend("warp")
        if options.get("local_frame"):
            blended_positions = [
                w * (rotation_matrix(moved[j]["local"] + identity) @ (x - c) + c + moved[j]["warp"])
                for w, j in pairs
                for c in [nodes[j, :3]]
            ]
            shift = np.asarray(sum(blended_positions)) - x
        turn = mask * blend("rotation")
        if not residual:
            turn = mask * (blend("rotation") + identity - identity) + identity
        rotation = np.array([columns[f"rot_{i}"][row] for i in range(4)]) + turn
        scale = np.exp([columns[f"scale_{i}"][row] for i in range(3)]) + mask * blend("scaling")
        root = rotation_matrix(rotation) @ np.diag(scale)
        opacity = 1 / (1 + np.exp(-columns["opacity"][row]))
        if options.get("pred_opacity"):
            opacity += mask * blend("opacity")[0]
        sh_rest = table("f_rest")[row].reshape(3, -1).T
        sh = np.concatenate([table("f_dc")[row][None], sh_rest])
        if options.get("pred_color"):
            sh[0] += mask * blend("color")
        rows["position"].append(x + mask * shift)
        rows["opacity"].append(np.clip(opacity, 0, 1))
        rows["covariance"].append(upper(root @ root.T))
        rows["color"].append(sh.reshape(-1))
    arrays = {name: np.array(value) for name, value in rows.items()}
    return ExpectedGaussians(np.ones(len(features), bool), **arrays)

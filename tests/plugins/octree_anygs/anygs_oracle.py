"""What Octree-AnyGS computes, written out in float64 from the files of a run.

Follows `scene/gs_model_*/*_model.py` of its published code: `set_anchor_mask` chooses anchors, and
`generate_neural_gaussians` makes Gaussians of them.
"""

import ast
import warnings
from pathlib import Path

import numpy as np
import torch

from gsgen.contract.spec.geometry import covariance_upper
from support.checkpoints.plugin_oracles import ExpectedGaussians
from support.checkpoints.spacetime_oracles import raw_columns


def _table(columns: dict[str, np.ndarray], prefix: str) -> np.ndarray:
    count = sum(name.startswith(prefix) for name in columns)
    return np.stack([columns[f"{prefix}{index}"] for index in range(count)], axis=1)


def _infos(path: Path) -> dict[str, float]:
    lines = path.read_bytes().partition(b"end_header")[0].decode().splitlines()
    words = [line.split() for line in lines if line.startswith("obj_info")]
    return {name: float(number) for _, name, number in words}


def _config(run: Path) -> dict[str, object]:
    call = ast.parse((run / "cfg_args").read_text(), mode="eval").body
    options = {word.arg: ast.literal_eval(word.value) for word in call.keywords}
    return options["model_config"]["kwargs"] | {"base": options["base_model"]}


def expected_gaussians(run: Path, camera: np.ndarray, uid: int | None = None) -> ExpectedGaussians:
    """Return the Gaussians that the method draws for a camera, given as in the contract."""
    config = _config(run)
    (files,) = (run / "point_cloud").iterdir()
    columns = raw_columns(files / "point_cloud.ply")
    centre = np.linalg.inv(camera.astype(np.float64).T)[:3, 3]
    anchor = np.stack([columns[axis] for axis in "xyz"], axis=1)
    visible, fade, is_ambiguous = _levels(columns, config, files, anchor, centre)
    offset = _table(columns, "f_offset_")
    k = offset.shape[1] // 3
    offset = offset.reshape(-1, 3, k).transpose(0, 2, 1)
    scale, rotation = np.exp(_table(columns, "scale_")), _table(columns, "rot_")
    position = (anchor[:, None] + offset * scale[:, None, :3]).reshape(-1, 3)
    base = np.repeat(scale[:, 3:], k, axis=0)
    if config["base"] == "scaffoldgs":
        opacity, color, shape = _networks(columns, config, files, anchor - centre, uid)
        opacity = (opacity * fade[:, None]).reshape(-1)
        base = base / (1 + np.exp(-shape[:, :3]))
        rotation = shape[:, 3:]
        drawn = (opacity > 0) & np.repeat(visible, k)
    else:
        opacity = fade / (1 + np.exp(-columns["opacity"]))
        sh_rest = (
            _table(columns, "f_rest_") if "f_rest_0" in columns else np.zeros((len(anchor), 0))
        )
        dc = np.stack([columns[f"f_dc_{channel}"] for channel in range(3)], axis=1)
        sh_rest = sh_rest.reshape(len(anchor), 3, -1).transpose(0, 2, 1)
        color = np.concatenate([dc[:, None], sh_rest], axis=1).reshape(len(anchor), -1)
        drawn = visible
        if config["base"] == "2dgs":
            base = base * [1.0, 1.0, 0.0]  # a disc
    return ExpectedGaussians(
        drawn,
        position[drawn],
        opacity[drawn],
        covariance_upper(base[drawn], rotation[drawn]),
        color[drawn],
        np.repeat(is_ambiguous, k),
    )


def _levels(
    columns: dict[str, np.ndarray],
    config: dict[str, object],
    files: Path,
    anchor: np.ndarray,
    centre: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which anchors are visible, how far they have faded in, and which are at a threshold."""
    count = len(anchor)
    if "level" not in columns:
        return np.ones(count, bool), np.ones(count), np.zeros(count, bool)
    infos = _infos(files / "point_cloud.ply")
    distance = np.sqrt(((anchor - centre) ** 2).sum(axis=1))
    predicted = np.log2(infos["standard_dist"] / distance) / np.log2(config["fork"])
    predicted = predicted + columns["extra_level"]
    top_level, mode = round(infos["levels"]) - 1, config["dist2level"]
    fade = np.ones(count)
    if mode == "progressive":
        clamped = np.clip(predicted + 1, 0.9999, top_level + 0.9999)
        whole = np.floor(clamped)
        fade = np.where(columns["level"] == whole, clamped - whole, 1.0)
        near = predicted
    else:
        function = {"round": np.round, "floor": np.floor, "ceil": np.ceil}[mode]
        whole = np.clip(function(predicted), 0, top_level)
        near = predicted + (0.5 if mode == "round" else 0.0)
    return columns["level"] <= whole, fade, np.abs(near - np.round(near)) < 1e-4


def _state(path: Path) -> dict[str, np.ndarray]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch.jit.load is deprecated, but wrote these files
        state = torch.jit.load(path).state_dict()
    return {key: value.double().numpy() for key, value in state.items()}


def _networks(
    columns: dict[str, np.ndarray],
    config: dict[str, object],
    files: Path,
    ray: np.ndarray,
    uid: int | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return opacity [N, K], colour [N K, 3], and scale and rotation [N K, 7]."""

    def ask(name: str, inputs: np.ndarray) -> np.ndarray:
        tensors = _state(files / f"{name}.pt")
        hidden = np.maximum(inputs @ tensors["0.weight"].T + tensors["0.bias"], 0)
        return np.asarray(hidden @ tensors["2.weight"].T + tensors["2.bias"])

    feature = _table(columns, "f_anchor_feat_")
    view = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    if config["use_feat_bank"]:
        weight = np.exp(ask("feature_bank_mlp", view))
        weight /= weight.sum(axis=1, keepdims=True)
        feature = (
            np.tile(feature[:, ::4], 4) * weight[:, :1]
            + np.tile(feature[:, ::2], 2) * weight[:, 1:2]
            + feature * weight[:, 2:]
        )
    inputs = np.concatenate([feature, view], axis=1) if config["view_dim"] else feature
    network_input = inputs
    if config["appearance_dim"]:
        (table,) = _state(files / "embedding_appearance.pt").values()
        rows = np.repeat(table[uid][None], len(inputs), axis=0)
        network_input = np.concatenate([inputs, rows], axis=1)
    color = 1 / (1 + np.exp(-ask("color_mlp", network_input)))
    return (
        np.tanh(ask("opacity_mlp", inputs)),
        color.reshape(-1, 3),
        ask("cov_mlp", inputs).reshape(-1, 7),
    )

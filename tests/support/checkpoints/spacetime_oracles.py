"""What SpacetimeGaussians and rotor 4DGS compute, Gaussian by Gaussian in float64.

The functions read the files by themselves, and follow the formulas of the papers.
"""

from pathlib import Path

import numpy as np
import torch

from support.checkpoints.plugin_oracles import ExpectedGaussians


def raw_columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a binary PLY of floats as float64."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = data[:end].decode().splitlines()
    names = [line.split()[2] for line in lines if line.startswith("property")]
    table = np.frombuffer(data[end:], "<f4").reshape(-1, len(names)).astype(np.float64)
    return dict(zip(names, table.T, strict=True))


def _rotation(q: np.ndarray) -> np.ndarray:
    """Return the matrix of a quaternion (w, x, y, z): v ↦ q v q*, column by column."""
    w, *u = q / np.linalg.norm(q)
    axis = np.array(u)
    return np.stack(
        [
            (w * w - axis @ axis) * e + 2 * (axis @ e) * axis + 2 * w * np.cross(axis, e)
            for e in np.eye(3)
        ],
        axis=1,
    )


def upper(matrix: np.ndarray) -> np.ndarray:
    """Return xx xy xz yy yz zz of a matrix."""
    return matrix[np.triu_indices(3)]


def spacetime(folder: Path, time: float, camera: np.ndarray | None = None) -> ExpectedGaussians:
    """SpacetimeGaussians (Li et al. 2024, equations 5 to 8), decoded per splat if it is full."""
    (path,) = folder.rglob("point_cloud.ply")
    columns = raw_columns(path)
    count = len(columns["x"])
    position, opacity = np.zeros((count, 3)), np.zeros(count)
    covariance, color = np.zeros((count, 6)), np.zeros((count, 3))
    for row in range(count):
        splat = {name: column[row] for name, column in columns.items()}
        dt = time - splat["trbf_center"]
        for axis, name in enumerate("xyz"):
            powers = [splat[f"motion_{3 * power + axis}"] for power in range(3)]
            terms = (b * dt ** (k + 1) for k, b in enumerate(powers))
            position[row, axis] = splat[name] + sum(terms)
        duration = np.exp(splat["trbf_scale"])
        opacity[row] = np.exp(-((dt / duration) ** 2)) / (1 + np.exp(-splat["opacity"]))
        q = np.array([splat[f"rot_{i}"] + dt * splat[f"omega_{i}"] for i in range(4)])
        root = _rotation(q) @ np.diag([np.exp(splat[f"scale_{i}"]) for i in range(3)])
        covariance[row] = upper(root @ root.T)
        color[row] = [splat[f"f_dc_{i}"] for i in range(3)]
        if camera is not None:
            color[row] += _decoded(path.with_suffix(".pt"), splat, dt, position[row], camera)
            color[row] = 1 / (1 + np.exp(-color[row]))
    return ExpectedGaussians(np.ones(count, bool), position, opacity, covariance, color)


def _decoded(
    decoder: Path, splat: dict[str, float], dt: float, position: np.ndarray, camera: np.ndarray
) -> np.ndarray:
    """Return what the network adds to the base colour along the ray through a centre."""
    state = torch.load(decoder, weights_only=True)
    hidden, out = (state[f"mlp{i}.weight"].double().numpy()[:, :, 0, 0] for i in (1, 2))
    eye = np.linalg.inv(camera.astype(np.float64).T)[:3, 3]
    ray = (position - eye) / np.linalg.norm(position - eye)
    specular = [splat[f"f_dc_{i}"] for i in range(3, 6)]
    changing = [dt * splat[f"f_t_{i}"] for i in range(3)]
    values = hidden @ np.concatenate([specular, changing, eye, ray])
    added: np.ndarray = out @ np.maximum(values, 0)
    return added

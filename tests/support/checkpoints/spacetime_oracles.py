"""What SpacetimeGaussians, rotor 4DGS and Ex4DGS compute, Gaussian by Gaussian in float64.

The functions read the files by themselves, and follow the formulas of the papers.
"""

from pathlib import Path

import numpy as np
import torch

from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.reference_plugins.loading.cfg_args import read_cfg_args
from support.checkpoints.plugin_oracles import ExpectedGaussians


def raw_columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a binary PLY of floats as float64."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = data[:end].decode().splitlines()
    names = [line.split()[2] for line in lines if line.startswith("property")]
    table = np.frombuffer(data[end:], "<f4").reshape(-1, len(names)).astype(np.float64)
    return dict(zip(names, table.T, strict=True))


def rotation_matrix(q: np.ndarray) -> np.ndarray:
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
        root = rotation_matrix(q) @ np.diag([np.exp(splat[f"scale_{i}"]) for i in range(3)])
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


def _hamilton(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Multiply two quaternions."""
    real = p[0] * q[0] - p[1:] @ q[1:]
    return np.array([real, *(p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:]))])


def _rotor_matrix(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the 4-D rotation x ↦ l x r* of quaternions that count time, z, y, x."""
    left, right = left / np.linalg.norm(left), right / np.linalg.norm(right)
    conjugate = right * [1, -1, -1, -1]
    columns = [_hamilton(_hamilton(left, axis[::-1]), conjugate)[::-1] for axis in np.eye(4)]
    return np.stack(columns, axis=1)


def rotor(
    folder: Path,
    time: float,
    duration: tuple[float, float],
    camera: np.ndarray | None = None,
    prefilter: float = 0.0,
) -> ExpectedGaussians:
    """Rotor 4DGS (Yang et al. 2024), conditioned by way of the inverse 4-D covariance."""
    (path,) = folder.glob("chkpnt*.pth")
    values, _ = torch.load(path, weights_only=True)
    degree, center, dc, sh_rest, log_scale, left, logit = (
        value if isinstance(value, int) else value.double().numpy() for value in values[:7]
    )
    temporal_center, log_temporal, right = (value.double().numpy() for value in values[13:16])
    length = duration[1] - duration[0]
    moment = duration[0] + time * length
    sh = np.concatenate([dc, sh_rest], axis=1)
    rows: dict[str, list] = {name: [] for name in ("position", "opacity", "covariance", "color")}
    factors = np.zeros(len(center))
    for row, mean in enumerate(center):
        dt = moment - temporal_center[row, 0]
        if values[16]:
            axes = _rotor_matrix(left[row], right[row])
            scale = np.exp(np.concatenate([log_scale[row], log_temporal[row]]))
            whole = axes @ np.diag(scale**2) @ axes.T
            precision = np.linalg.inv(whole)
            covariance = np.linalg.inv(precision[:3, :3])
            shift = -covariance @ precision[:3, 3] * dt
            variance = whole[3, 3]
        else:
            root = rotation_matrix(left[row]) @ np.diag(np.exp(log_scale[row]))
            covariance, shift, variance = root @ root.T, np.zeros(3), np.exp(log_temporal[row, 0])
        factors[row] = np.exp(-0.5 * dt * dt / (variance + max(prefilter, 0)))
        coefficients = sh[row, :16].copy()
        if sh.shape[1] == 48 and degree == 3:
            for harmonic in range(1, values[18] + 1):
                block = sh[row, 16 * harmonic : 16 * harmonic + 16]
                coefficients += np.cos(2 * np.pi * harmonic * dt / length) * block
        color = coefficients[: (degree + 1) ** 2]
        if camera is not None:
            eye = np.linalg.inv(camera.astype(np.float64).T)[:3, 3]
            ray = (mean - eye) / np.linalg.norm(mean - eye)
            color = np.maximum(basis(ray, degree) @ color + 0.5, 0)
        if factors[row] > 0.05:
            rows["position"].append(mean + shift)
            rows["opacity"].append(factors[row] / (1 + np.exp(-logit[row, 0])))
            rows["covariance"].append(upper(covariance))
            rows["color"].append(color.reshape(-1))
    return ExpectedGaussians(
        factors > 0.05,
        **{name: np.array(value) for name, value in rows.items()},
        doubtful=np.abs(factors - 0.05) < 1e-5,
    )


def ex4dgs(folder: Path, time: float, drift_duration: float | None = None) -> ExpectedGaussians:
    """Ex4DGS (Lee et al. 2024), whose key frames are looked up at a time from 0 to 1."""
    (path,) = folder.rglob("iteration_*/point_cloud.ply")
    still, moving = raw_columns(path), raw_columns(path.with_name("dynamic_point_cloud.ply"))
    cfg = read_cfg_args(folder).values
    frame = time * (cfg["duration"] - 1)
    is_line = cfg["interp_type"] == "linear"
    shift = cfg["time_pad"] + (0 if is_line else cfg["time_interval"])
    key = (frame + shift) / cfg["time_interval"]
    rows: dict[str, list] = {name: [] for name in ("position", "opacity", "covariance", "color")}
    doubtful = [False] * len(still["x"])
    for row in range(len(still["x"])):
        splat = {name: column[row] for name, column in still.items()}
        centre, drift = (_parts(splat, name, 3) for name in ("", "xyz_disp_"))
        rows["position"].append(centre + drift * frame / (drift_duration or cfg["duration"]))
        rows["opacity"].append(1 / (1 + np.exp(-splat["opacity"])))
        # The matrix of a quaternion that is not normalised: 1 − 2(…), not divided by its length.
        q = _parts(splat, "rot_", 4)
        turn = np.eye(3) + q @ q * (rotation_matrix(q) - np.eye(3))
        rows["covariance"].append(_covariance(turn, _parts(splat, "scale_", 3)))
        rows["color"].append(_coefficients(splat, ""))
    for row in range(len(moving["motion_opacity"])):
        splat = {name: column[row] for name, column in moving.items()}
        whole = int(key)
        share = key - whole
        rows["position"].append(_interpolated(splat, whole, share, cfg["interp_type"]))
        start, end = (
            q / np.linalg.norm(q)
            for q in (_parts(splat, f"motion_rot_{whole + i}_", 4) for i in range(2))
        )
        angle = np.arccos(np.clip(start @ end, 1e-4 - 1, 1 - 1e-4))
        q = np.sin((1 - share) * angle) * start + np.sin(share * angle) * end
        scale = _parts(splat, "motion_scale_", 3)
        rows["covariance"].append(_covariance(rotation_matrix(q), scale))
        first, last = sorted(_parts(splat, "motion_opacity_c_", 2))
        width = np.exp(splat[f"motion_opacity_v_{int(key > first)}"])
        width += cfg["var_pad"] / cfg["time_interval"] / 2.36
        factor = 1.0 if first < key < last else np.exp(-(((key - last) / width) ** 2))
        rows["opacity"].append(factor / (1 + np.exp(-splat["motion_opacity"])))
        rows["color"].append(_coefficients(splat, "motion_"))
        doubtful.append(min(abs(key - first), abs(key - last)) < 1e-5)
    values = {name: np.array(value) for name, value in rows.items()}
    retained = np.ones(len(doubtful), bool)
    return ExpectedGaussians(retained, **values, doubtful=np.array(doubtful))


def _parts(splat: dict[str, float], prefix: str, count: int) -> np.ndarray:
    return np.array([splat[f"{prefix}{i}" if prefix else "xyz"[i]] for i in range(count)])


def _covariance(rotation: np.ndarray, log_scale: np.ndarray) -> np.ndarray:
    return upper(rotation @ np.diag(np.exp(2 * log_scale)) @ rotation.T)


def _coefficients(splat: dict[str, float], prefix: str) -> np.ndarray:
    """Return the SH coefficients of a splat, those of red, green and blue in turn."""
    rest = [value for name, value in splat.items() if name.startswith(f"{prefix}f_rest_")]
    dc = _parts(splat, f"{prefix}f_dc_", 3)
    return np.concatenate([dc[None], np.reshape(rest, (3, -1)).T]).reshape(-1)


def _interpolated(splat: dict[str, float], key: int, share: float, kind: str) -> np.ndarray:
    """Return the centre between two key frames, by the four polynomials of Hermite."""
    start, end = (_parts(splat, f"motion_xyz_{key + i}_", 3) for i in range(2))
    if kind == "linear":
        return (1 - share) * start + share * end
    before, after = (_parts(splat, f"motion_xyz_{key + i}_", 3) for i in (-1, 2))
    slopes = []
    for left, right in ((start - before, end - start), (end - start, after - end)):
        mean = (left + right) / 2
        if kind == "pchip":
            mean = np.array(
                [
                    2 / (1 / a + 1 / b) if a * b > 0 else 0.0
                    for a, b in zip(left, right, strict=True)
                ]
            )
        slopes.append(mean)
    s = share
    centre: np.ndarray = (
        (2 * s**3 - 3 * s**2 + 1) * start
        + (s**3 - 2 * s**2 + s) * slopes[0]
        + (3 * s**2 - 2 * s**3) * end
        + (s**3 - s**2) * slopes[1]
    )
    return centre

"""What published methods compute, written out plainly in float64 with shapes that depend on data.

Each function follows the formulas of its method, not the code of our generators: masks select
rows, grids are sampled, matrices are inverted.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCheckpoint, Mlp
from gsgen.reference_plugins.deformation.deformation_checkpoint import DeformationCheckpoint
from gsgen.reference_plugins.deformation.hexplane_checkpoint import HexPlaneCheckpoint


@dataclass
class ExpectedGaussians:
    """Rows that the method draws, and where they stand among all; the rest must not show."""

    retained: np.ndarray
    position: np.ndarray
    opacity: np.ndarray
    covariance: np.ndarray
    color: np.ndarray
    doubtful: np.ndarray | None = None  # rows too close to a threshold to be judged


def _mlp(net: Mlp, x: torch.Tensor) -> torch.Tensor:
    hidden = torch.relu(F.linear(x, net.hidden.double(), net.hidden_bias.double()))
    return F.linear(hidden, net.out.double(), net.out_bias.double())


def anchors(
    read: AnchorCheckpoint, camera: np.ndarray, uid: int | None, *, octree: bool
) -> ExpectedGaussians:
    """Scaffold-GS (`gaussian_renderer/__init__.py`) and Octree-GS with its levels."""
    cloud, nets = read.cloud, read.nets
    n, k = len(cloud), cloud.per_anchor
    centre = torch.from_numpy(np.linalg.inv(camera.astype(np.float64).T)[:3, 3])
    visible, fade, is_ambiguous = torch.ones(n, dtype=torch.bool), None, torch.zeros(n).bool()
    if octree:
        visible, fade, is_ambiguous = _levels(read, centre)
    anchor = cloud.position.double()[visible]
    feature, log_scale = cloud.feature.double()[visible], cloud.log_scale.double()[visible]
    offset = cloud.offset.double()[visible]
    v = anchor - centre
    d = v.norm(dim=1, keepdim=True)
    v = v / d
    level = [cloud.level.double()[visible][:, None]] if nets.level else []
    if nets.feature_bank is not None:
        bank_inputs = [v, *level] if octree else [v, d]
        w = torch.softmax(_mlp(nets.feature_bank, torch.cat(bank_inputs, 1)), 1)[:, :, None]
        f = feature[:, :, None]
        f = (
            f[:, ::4].repeat(1, 4, 1) * w[:, :1]
            + f[:, ::2].repeat(1, 2, 1) * w[:, 1:2]
            + f * w[:, 2:]
        )
        feature = f[:, :, 0]

    def ask(net: Mlp, *extra: torch.Tensor) -> torch.Tensor:
        parts = [feature, v, *([d] if net.distance else []), *level, *extra]
        return _mlp(net, torch.cat(parts, 1))

    features = []
    if nets.embedding is not None:
        features = [nets.embedding.double()[uid].expand(len(anchor), -1)]
    opacity = torch.tanh(ask(nets.opacity))
    if fade is not None:
        opacity = opacity * fade[visible][:, None]
    opacity = opacity.reshape(-1)
    opaque = opacity > 0
    color = torch.sigmoid(ask(nets.color, *features)).reshape(-1, 3)[opaque]
    shape = ask(nets.covariance).reshape(-1, 7)[opaque]
    base = log_scale.exp().repeat_interleave(k, 0)[opaque]
    scale = base[:, 3:] * torch.sigmoid(shape[:, :3])
    position = anchor.repeat_interleave(k, 0)[opaque] + offset.reshape(-1, 3)[opaque] * base[:, :3]
    retained = torch.zeros(n, k, dtype=torch.bool)
    retained[visible] = opaque.reshape(-1, k)
    return ExpectedGaussians(
        retained.reshape(-1).numpy(),
        position.numpy(),
        opacity[opaque].numpy(),
        covariance_upper(scale.numpy(), shape[:, 3:].numpy()),
        color.numpy(),
        is_ambiguous.repeat_interleave(k).numpy(),
    )


def _levels(
    read: AnchorCheckpoint, centre: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor | None, torch.Tensor]:
    cloud, cfg = read.cloud, read.run.cfg
    fork, mode = cfg.values["fork"], cfg.values["dist2level"]
    level = cloud.level.double()
    voxel, standard = cloud.info[:2].double()
    middle = cloud.position.double() + (voxel / 2 / fork**level)[:, None]
    distance = (middle - centre).norm(dim=1)
    level_of_distance = torch.log2(standard / distance) / np.log2(fork) + cloud.extra_level.double()
    top_level = level.max() - level.min()
    fade = None
    if mode == "progressive":
        clamped = (level_of_distance + 1).clamp(0.9999, float(top_level) + 0.9999)
        whole = clamped.floor()
        fade = torch.where(level == whole, clamped - whole, 1.0)
        near = ((level_of_distance + 1) - (level_of_distance + 1).round()).abs()
    else:
        whole = getattr(torch, mode)(level_of_distance).clamp(0, top_level)
        shift = {"round": 0.5, "floor": 0.0, "ceil": 0.0}[mode]
        near = ((level_of_distance + shift) - (level_of_distance + shift).round()).abs()
    return level <= whole, fade, near < 1e-4


def hexplane(read: HexPlaneCheckpoint, time: float) -> ExpectedGaussians:
    """4DGaussians (`scene/deformation.py`, `scene/hexplane.py`): every plane is sampled."""
    nets, flags, canonical = read.nets, read.flags, read.canonical
    upper, lower = nets.aabb.double()
    scaled = (canonical.position.double() - upper) * (2.0 / (lower - upper)) - 1.0
    scaled = torch.cat([scaled, torch.full_like(scaled[:, :1], time)], 1)
    features = []
    for planes in nets.grids:
        product: torch.Tensor | float = 1.0
        for plane, axes in zip(planes, combinations(range(4), 2), strict=True):
            samples = scaled[:, list(axes)][None, None]
            cells = F.grid_sample(
                plane.double()[None], samples, align_corners=True, padding_mode="border"
            )
            product = product * cells[0, :, 0].T
        features.append(product)
    hidden = torch.cat(features, 1)
    for index, (weight, bias) in enumerate(nets.feature):
        hidden = F.linear(torch.relu(hidden) if index else hidden, weight.double(), bias.double())

    def head(pair: tuple) -> torch.Tensor:
        (a, b), (c, d) = pair
        inner = F.linear(torch.relu(hidden), a.double(), b.double())
        return F.linear(torch.relu(inner), c.double(), d.double())

    mask = torch.ones_like(scaled[:, :1])
    if flags.mask == "static_mlp":
        mask = head(nets.static)
    if flags.mask == "empty_voxel":
        grid, low, high = nets.voxels
        samples = ((canonical.position.double() - low) / (high - low)).flip(-1) * 2 - 1
        cells = F.grid_sample(
            grid.double()[None, None], samples[None, None, None], align_corners=True
        )
        mask = cells.reshape(-1, 1)
    outputs = {name: head(pair) for name, pair in nets.heads.items()}
    position, log_scale = canonical.position.double(), canonical.log_scale.double()
    rotation, opacity = canonical.rotation.double(), canonical.logit_opacity.double()
    sh = canonical.sh.double()
    if "pos" in outputs:
        position = position * mask + outputs["pos"]
    if "scales" in outputs:
        log_scale = log_scale * mask + outputs["scales"]
    if "opacity" in outputs:
        opacity = opacity * mask + outputs["opacity"]
    if "shs" in outputs:
        sh = sh * mask[:, :, None] + outputs["shs"].reshape(len(sh), 16, 3)
    if "rotations" in outputs and not flags.apply_rotation:
        rotation = rotation + outputs["rotations"]
    elif "rotations" in outputs:
        rotation = _multiplied(rotation, outputs["rotations"])
    return ExpectedGaussians(
        np.ones(len(sh), bool),
        position.numpy(),
        torch.sigmoid(opacity)[:, 0].numpy(),
        covariance_upper(log_scale.exp().numpy(), rotation.numpy()),
        sh.flatten(1).numpy(),
    )


def _multiplied(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Multiply quaternions by way of 4×4 matrices."""
    w, x, y, z = a.T
    rows = [[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]
    matrix = torch.stack([torch.stack(row, -1) for row in rows], -2)
    return (matrix @ b[:, :, None])[:, :, 0]


def _embedded(x: torch.Tensor, octaves: int) -> torch.Tensor:
    parts = [x]
    for octave in range(octaves):
        parts += [torch.sin(x * 2.0**octave), torch.cos(x * 2.0**octave)]
    return torch.cat(parts, -1)


def _skew(v: torch.Tensor) -> torch.Tensor:
    matrix = torch.zeros(len(v), 3, 3, dtype=v.dtype)
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return matrix - matrix.transpose(1, 2)


def deformation(read: DeformationCheckpoint, time: float) -> ExpectedGaussians:
    """Deformable-3D-Gaussians (`utils/time_utils.py`, `utils/rigid_utils.py`)."""
    net, canonical = read.net, read.canonical
    x = canonical.position.double()
    t = torch.full((len(x), 1), time, dtype=torch.float64)
    moment = _embedded(t, 6 if net.time is not None else 10)
    if net.time is not None:
        (a, b), (c, d) = net.time
        moment = F.linear(moment, a.double(), b.double())
        moment = F.linear(torch.relu(moment), c.double(), d.double())
    scaled = torch.cat([_embedded(x, 10), moment], 1)
    hidden = scaled
    for index, (weight, bias) in enumerate(net.layers):
        hidden = torch.relu(F.linear(hidden, weight.double(), bias.double()))
        if index == 4:
            hidden = torch.cat([scaled, hidden], 1)

    def last(layer: tuple) -> torch.Tensor:
        return F.linear(hidden, layer[0].double(), layer[1].double())

    if len(net.warp) == 1:
        position = x + last(net.warp[0])
    else:
        axis, v = last(net.warp[0]), last(net.warp[1])
        theta = axis.norm(dim=1, keepdim=True)
        w, v = _skew(axis / theta + 1e-5), v / theta + 1e-5
        angle, eye = theta[:, :, None], torch.eye(3, dtype=torch.float64)
        turn = eye + torch.sin(angle) * w + (1 - torch.cos(angle)) * w @ w
        translation_matrix = (
            angle * eye + (1 - torch.cos(angle)) * w + (angle - torch.sin(angle)) * w @ w
        )
        position = (turn @ x[:, :, None] + translation_matrix @ v[:, :, None])[:, :, 0]
    scale = canonical.log_scale.double().exp() + last(net.scaling)
    q = F.normalize(canonical.rotation.double(), dim=1) + last(net.rotation)
    w, i, j, k = q.T
    rows = [
        [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)],
        [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
        [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)],
    ]
    root = torch.stack([torch.stack(row, -1) for row in rows], -2) * scale[:, None]
    full = root @ root.transpose(1, 2)
    return ExpectedGaussians(
        np.ones(len(x), bool),
        position.numpy(),
        torch.sigmoid(canonical.logit_opacity.double())[:, 0].numpy(),
        full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].numpy(),
        canonical.sh.double().flatten(1).numpy(),
    )

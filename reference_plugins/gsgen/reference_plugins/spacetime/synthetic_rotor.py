"""Writes synthetic checkpoints of rotor 4DGS, as its training code does.

The Gaussians are a torus knot along which splats move; they appear and fade.
"""

__all__ = ["write_rotor"]

from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.writing.knot import torus_knot
from gsgen.reference_plugins.writing.run_files import write_cfg_args
from gsgen.sdk.math import quaternion_multiply

_ITERATION_NUMBER = 30_000


def write_rotor(
    folder: Path,
    *,
    count: int = 64,
    rot_4d: bool = True,
    coefficients: int = 48,
    degree: int = 3,
    duration: tuple[float, float] = (0.0, 1.0),
    sway: float = 0.8,
    seed: int = 0,
) -> Path:
    """Write a synthetic checkpoint of rotor 4DGS with its ``config.yaml``; return the folder.

    ``rot_4d`` lets Gaussians move, at about ``sway`` units of a knot that is three wide;
    ``coefficients`` are 16, or 48 for colours that change; ``degree`` is the active SH degree.
    """
    noise = torch.Generator().manual_seed(seed)
    knot_splats = torus_knot(count, seed=seed)
    position, length = torch.from_numpy(knot_splats.position), duration[1] - duration[0]
    share = torch.linspace(0, 1, count)[:, None]
    # Each fourth Gaussian rests and lasts as long as the scene, the others for a part of it.
    is_static = torch.arange(count)[:, None] % 4 == 0
    part = 0.18 + 0.04 * torch.randn((count, 1), generator=noise).clamp(-2, 2)
    duration_scale = torch.where(is_static, 3.0, part) * length
    x, _, z = torch.split(position, 1, dim=1)
    velocity = sway / length * torch.cat([z, torch.sin(3 * x), -x], dim=1) * ~is_static
    left_rotor, right_rotor = _rotors(velocity, torch.randn((count, 4), generator=noise))
    sh = torch.zeros((count, coefficients, 3))
    sh[:, :16] = torch.from_numpy(knot_splats.sh)
    sh[:, 16:] = 0.2 * torch.randn((count, coefficients - 16, 3), generator=noise)
    sh[:, 17:32] *= 0.2
    values: tuple[Any, ...] = (
        degree,
        position,
        sh[:, :1],
        sh[:, 1:],
        torch.from_numpy(knot_splats.log_scale),
        left_rotor if rot_4d else torch.from_numpy(knot_splats.rotation),
        torch.from_numpy(knot_splats.logit_opacity)[:, None],
        *(torch.zeros(count), *(torch.zeros((count, 1)) for _ in range(3))),  # statistics
        {"state": {}, "param_groups": []},
        4.2,  # extent of the scene
        duration[0] + length * share,
        torch.log(duration_scale) * (1 if rot_4d else 2),
        right_rotor if rot_4d else torch.empty(0),
        rot_4d,
        None,  # background
        coefficients // 16 - 1,
    )
    write_cfg_args(folder, {"sh_degree": 3, "frame_ratio": 1, "prefilter_var": -1.0})
    torch.save((values, _ITERATION_NUMBER), folder / f"chkpnt{_ITERATION_NUMBER}.pth")
    text = f"gaussian_dim: 4\ntime_duration: [{duration[0]}, {duration[1]}]\nrot_4d: {rot_4d}\n"
    (folder / "config.yaml").write_text(text, "utf-8")
    return folder


def _rotors(
    velocity: Float[Tensor, "n 3"], turn: Float[Tensor, "n 4"]
) -> tuple[Float[Tensor, "n 4"], Float[Tensor, "n 4"]]:
    """Return quaternion pairs of 4D rotations: a rotation in space, then a tilt along a velocity.

    The latter is x ↦ b x b with b = (cos θ/2, sin θ/2 v) and tan θ = ‖velocity‖, so the pair of
    both is x ↦ (b g) x (g* b), of which the second factor is stored conjugated.
    """
    speed = velocity.norm(dim=1, keepdim=True)
    half_angle = torch.atan(speed) / 2
    axis = (velocity / speed.clamp(min=1e-12)).flip(1)  # quaternions count time, z, y, x
    time_rotation_rotor = torch.cat([half_angle.cos(), half_angle.sin() * axis], dim=1)
    inverse = torch.cat([time_rotation_rotor[:, :1], -time_rotation_rotor[:, 1:]], dim=1)
    return quaternion_multiply(time_rotation_rotor, turn), quaternion_multiply(inverse, turn)

"""Body models and checkpoints of people, in the layout of the files that are licensed or trained.

The bodies are blobs around the bones of a stick figure, with noise for blendshapes: nothing in them
comes from SMPL but the order of its joints.
"""

__all__ = [
    "PersonOptions",
    "write_body",
    "write_gauhuman",
    "write_lhm",
    "write_motion",
    "write_r3",
]

import pickle
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.formats import Splats, write_ply
from gsgen.reference_plugins.synthetic.files import write_cfg_args, write_columns

_SMPL = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
# Jaw and eyes hang on the head; five fingers of three joints on each wrist.
_FINGERS = tuple(
    wrist if joint % 3 == 0 else first + joint - 1
    for wrist, first in ((20, 25), (21, 40))
    for joint in range(15)
)
_PARENTS = {24: _SMPL, 55: (*_SMPL[:22], 15, 15, 15, *_FINGERS)}
# Where each joint of root and body is, from its parent: a stick figure of 1.7 m, y up, arms apart.
_BONES = (
    *((0, 0, 0), (0.09, -0.09, 0), (-0.09, -0.09, 0), (0, 0.12, 0)),
    *(
        (0.02, -0.4, 0),
        (-0.02, -0.4, 0),
        (0, 0.14, 0),
        (0, -0.42, -0.02),
        (0, -0.42, -0.02),
    ),
    *((0, 0.06, 0), (0.02, -0.06, 0.13), (-0.02, -0.06, 0.13), (0, 0.21, 0)),
    *(
        (0.08, 0.12, 0),
        (-0.08, 0.12, 0),
        (0, 0.12, 0.03),
        (0.11, 0.03, 0),
        (-0.11, 0.03, 0),
    ),
    *((0.26, 0, 0), (-0.26, 0, 0), (0.25, 0, 0), (-0.25, 0, 0)),
)
_FACE = ((0, 0, 0.05), (0.03, 0.06, 0.07), (-0.03, 0.06, 0.07))
_NO_PARENT = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class PersonOptions:
    """What a training run may choose.

    Attributes:
        count: Gaussians.
        kind: ``smpl`` or ``smplx``.
        vertices: Of the body model.
        shapes: Its shape coefficients.
        nets: Joints and weights are corrected by networks (GauHuman's ``motion_offset_flag``).
        hands: The body model of SMPL-X has a mean pose of the hands.
        degree: Of the spherical harmonics.
        npz: The body model is an ``.npz``; a ``.pkl`` otherwise. SMPL-X always is.
        width: Of the networks; 128 in the published code.
        resolution: Cells of R3-Avatar's planes along x, y, z and t.
        channels: Of each plane.
        seed: Of all noise.
    """

    count: int = 60
    kind: str = "smpl"
    vertices: int = 150
    shapes: int = 10
    nets: bool = False
    hands: bool = False
    degree: int = 3
    npz: bool = False
    width: int = 16
    resolution: tuple[int, int, int, int] = (6, 5, 7, 8)
    channels: int = 4
    seed: int = 0

    @property
    def joints(self) -> int:
        """Of the body model."""
        return 24 if self.kind == "smpl" else 55


def _body(options: PersonOptions) -> dict[str, np.ndarray]:
    rng = np.random.default_rng([options.seed, 1])
    count, joints = options.vertices, options.joints
    parents = _PARENTS[joints]
    bones = _BONES + (((0.08, 0, 0), (-0.08, 0, 0)) if joints == 24 else _FACE)
    places = np.zeros((joints, 3))
    for joint, parent in enumerate(parents[1:], start=1):
        if joint < len(bones):
            bone = np.array(bones[joint])
        else:  # fingers: away from the body, side by side
            finger = (joint - len(bones)) // 3 % 5
            away = 0.08 if joint % 3 == len(bones) % 3 else 0.03
            bone = np.array([away if joint < 40 else -away, 0, 0.015 * (finger - 2)])
        places[joint] = places[parent] + bone
    # Every joint has vertices around it, from which it can be had back.
    home = np.concatenate([np.arange(joints), rng.integers(0, joints, count - joints)])
    # Half of them lie somewhere on the bone to the parent, and say nothing of the joint.
    bone = (np.arange(count) >= joints) & (rng.random(count) < 0.5)
    along = np.where(bone, rng.random(count), 0)[:, None]
    begin = places[np.maximum(np.array(parents)[home], 0)]
    template = places[home] * (1 - along) + begin * along + rng.normal(0, 0.03, (count, 3))
    away = np.linalg.norm(template[:, None] - places[None], axis=2)
    weights = np.exp(-((away / 0.12) ** 2))
    weights[weights < 0.02 * weights.max(axis=1, keepdims=True)] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    regressor = ((home[None] == np.arange(joints)[:, None]) & ~bone).astype(float)
    regressor /= regressor.sum(axis=1, keepdims=True)
    table = np.array([parents, range(joints)], np.int64) % (_NO_PARENT + 1)
    made = {
        "v_template": template,
        "shapedirs": rng.normal(0, 0.01, (count, 3, options.shapes)),
        "posedirs": rng.normal(0, 0.003, (count, 3, 9 * (joints - 1))),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": table.astype(np.uint32),
    }
    if options.hands:
        made["hands_meanl"], made["hands_meanr"] = rng.normal(0, 0.3, (2, 45))
    return {
        name: value if value.dtype.kind == "u" else value.astype(np.float32)
        for name, value in made.items()
    }


def write_body(path: Path, options: PersonOptions = PersonOptions()) -> Path:
    """Write a body model, ``.pkl`` or ``.npz`` as the name says, and return ``path``."""
    from scipy.sparse import csc_matrix

    path.parent.mkdir(parents=True, exist_ok=True)
    made: dict[str, Any] = dict(_body(options))
    if path.suffix == ".npz":
        np.savez(path, **made)
        return path
    made["J_regressor"] = csc_matrix(made["J_regressor"])
    made |= {"bs_style": "lbs", "bs_type": "lrotmin"}
    path.write_bytes(pickle.dumps(made, protocol=2))
    return path


def _assets(folder: Path, options: PersonOptions) -> None:
    file = (
        "models/smplx/SMPLX_NEUTRAL.npz" if options.kind == "smplx" else "SMPL_NEUTRAL.pkl"
    )
    write_body(folder / "assets" / file, options)


def _splats(options: PersonOptions) -> Splats:
    """Gaussians around the body, not far from some vertex."""
    rng = np.random.default_rng([options.seed, 2])
    template = _body(options)["v_template"]
    near = template[rng.integers(0, len(template), options.count)]
    count = options.count
    return Splats(
        position=(near + rng.normal(0, 0.03, (count, 3))).astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        log_scale=rng.normal(-4, 0.5, (count, 3)).astype(np.float32),
        logit_opacity=rng.normal(0, 2, count).astype(np.float32),
        sh=rng.normal(0, 0.4, (count, (options.degree + 1) ** 2, 3)).astype(np.float32),
    )


def write_gauhuman(folder: Path, options: PersonOptions = PersonOptions()) -> Path:
    """Write a checkpoint of GauHuman, its body model under ``assets``, and return ``folder``."""
    cfg = {"smpl_type": options.kind, "actor_gender": "neutral", "sh_degree": 3}
    write_cfg_args(folder, cfg | {"motion_offset_flag": options.nets})
    _assets(folder, options)
    place = folder / "point_cloud/iteration_1200"
    place.mkdir(parents=True, exist_ok=True)
    write_ply(place / "point_cloud.ply", _splats(options))
    if options.nets:
        pose, weights = _pose_nets(options)
        path = folder / "mlp_ckpt/iteration_1200/ckpt.pth"
        path.parent.mkdir(parents=True, exist_ok=True)
        state = {"iter": 1200, "pose_decoder": pose, "lweight_offset_decoder": weights}
        torch.save(state, path)
    return folder


def _pose_nets(options: PersonOptions) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    noise = torch.Generator().manual_seed(options.seed)
    turns, wide = 3 * (options.joints - 1), options.width
    pose: dict[str, Tensor] = {}
    for index, (inputs, outputs) in enumerate([(turns, wide), (wide, wide), (wide, turns)]):
        gain = 0.3 if index == 2 else 1.0
        pose |= _linear(f"block_mlps.{2 * index}", inputs, outputs, noise, gain)
    weights: dict[str, Tensor] = {}
    for index, inputs in enumerate([63, wide, wide, 63 + wide]):
        weights |= _linear(f"bw_linears.{index}", inputs, wide, noise)
    weights |= _linear("bw_fc", wide, options.joints, noise)
    convolved = {
        name: value[:, :, None] if value.ndim == 2 else value
        for name, value in weights.items()
    }
    return pose, convolved


def _linear(
    name: str, inputs: int, outputs: int, noise: torch.Generator, gain: float = 1.0
) -> dict[str, Tensor]:
    weight = torch.randn((outputs, inputs), generator=noise) * (gain / inputs**0.5)
    bias = 0.1 * gain * torch.randn(outputs, generator=noise)
    return {f"{name}.weight": weight, f"{name}.bias": bias}


def write_lhm(folder: Path, options: PersonOptions = PersonOptions()) -> Path:
    """Write an avatar of LHM with all that it needs, and return ``folder``.

    The body is always an SMPL-X of 400 shape coefficients; ``kind`` and ``shapes`` are not looked at.
    """
    body = PersonOptions(
        options.count, "smplx", options.vertices, 400, hands=True, seed=options.seed
    )
    arrays = _body(body)
    rng = np.random.default_rng([options.seed, 3])
    # Only some of the vertices have a face.
    arrays["shapedirs"][options.vertices // 3 :, :, 300:] = 0
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "SMPLX_NEUTRAL.npz", **arrays)  # type: ignore[arg-type]
    near = arrays["v_template"][rng.integers(0, options.vertices, options.count)]
    samples = (near + rng.normal(0, 0.02, near.shape)).astype(np.float32)
    points = folder / "pretrained_models/dense_sample_points/1_40000.ply"
    write_columns(points, {axis: samples[:, index] for index, axis in enumerate("xyz")})
    prior = folder / "pretrained_models/voxel_grid/human_prior_constrain.npz"
    prior.parent.mkdir(parents=True, exist_ok=True)
    np.savez(prior, masks=(rng.random(options.vertices) < 0.3).astype(np.float32))
    torch.save(_lhm_tensors(samples, rng), folder / "avatar.pth")
    return folder


def _lhm_tensors(samples: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> list[Any]:
    count = len(samples)
    quaternion = rng.normal(size=(count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    neutral = np.tile(np.eye(4), (55, 1, 1))
    neutral[:, :3, :3] = np.linalg.qr(np.eye(3) + rng.normal(0, 0.2, (55, 3, 3)))[0]
    neutral[:, :3, :3] *= np.sign(np.linalg.det(neutral[:, :3, :3]))[:, None, None]
    neutral[:, :3, 3] = rng.normal(0, 0.05, (55, 3))
    arrays = [
        rng.normal(0, 0.01, (count, 3)),
        samples,
        rng.random((count, 3)),
        rng.random((count, 1)),
        rng.uniform(0.002, 0.02, (count, 3)),
        quaternion,
        neutral,
        rng.normal(size=10),
    ]
    return [*(torch.from_numpy(one.astype(np.float32)) for one in arrays), 7.3, True]


def write_r3(folder: Path, options: PersonOptions = PersonOptions(nets=True)) -> Path:
    """Write a checkpoint of R3-Avatar trained on ZJU-MoCap, and return ``folder``."""
    cfg = {"smpl_type": options.kind, "actor_gender": "neutral", "sh_degree": 3}
    write_cfg_args(folder, cfg | {"source_path": "/data/zju_mocap/my_377"})
    _assets(folder, options)
    noise = torch.Generator().manual_seed(options.seed + 1)
    with _training_classes() as classes:
        fields = _r3_fields(options, noise, classes)
        torch.save((fields, 60000), folder / "chkpnt60000.pth")
    return folder


def _r3_fields(
    options: PersonOptions, noise: torch.Generator, classes: Mapping[str, type[nn.Module]]
) -> tuple[Any, ...]:
    splats = _splats(options)
    xyz, sh = torch.from_numpy(splats.position), torch.from_numpy(splats.sh)
    pose, weights = _pose_nets(options)
    grids = nn.ModuleList()
    for factor in (1, 2, 4):
        sizes = [*(factor * n for n in options.resolution[:3]), options.resolution[3]]
        planes = [
            0.8
            + 0.4 * torch.randn((1, options.channels, sizes[b], sizes[a]), generator=noise)
            for a, b in combinations(range(4), 2)
        ]
        grids.append(nn.ParameterList(planes))
    wide = options.width
    decoder = _linear("linear.0", 3 * options.channels, wide, noise)
    decoder |= _linear("linear.1", wide, wide, noise)
    heads = {
        "warp": (3, 0.02),
        "opacity": (1, 1.0),
        "rotation": (4, 1.0),
        "scaling": (3, 0.1),
    }
    for name, (outputs, gain) in heads.items():
        decoder |= _linear(f"gaussian_{name}", wide, outputs, noise, gain)
    margin = 0.05
    low, high = xyz.amin(dim=0) + margin, xyz.amax(dim=0) + margin  # some lie outside
    parameters = [
        nn.Parameter(one)
        for one in (xyz, sh[:, :1], sh[:, 1:], torch.from_numpy(splats.log_scale))
    ]
    return (
        *(3, *parameters, nn.Parameter(torch.from_numpy(splats.rotation))),
        nn.Parameter(torch.from_numpy(splats.logit_opacity)[:, None]),
        *(torch.zeros(0), torch.zeros(len(xyz), 1), torch.zeros(len(xyz), 1), {}, 1.0),
        _filled(classes["BodyPoseRefiner"](), pose),
        _filled(classes["LBSOffsetDecoder"](), weights),
        *(
            nn.Parameter(torch.stack([low, high])),
            [{"resolution": list(options.resolution)}],
        ),
        *(grids, 3 * options.channels, _filled(classes["GaussianDecoder"](), decoder)),
    )


def _filled(module: nn.Module, state: Mapping[str, Tensor]) -> nn.Module:
    """Give a module the tensors of a state dict, in modules of the names in it."""
    for path, value in state.items():
        *parents, name = path.split(".")
        at = module
        for parent in parents:
            if parent not in dict(at.named_children()):
                at.add_module(parent, nn.ModuleList())
            at = at.get_submodule(parent)
        at.register_parameter(name, nn.Parameter(value))
    return module


@contextmanager
def _training_classes() -> Iterator[dict[str, type[nn.Module]]]:
    """Let classes be pickled under the names that they have in the training code."""
    homes = {
        "GaussianDecoder": "gaussian_decoder",
        "BodyPoseRefiner": "mlp_delta_body_pose",
        "LBSOffsetDecoder": "mlp_delta_weight_lbs",
    }
    made, modules = {}, {"nets": ModuleType("nets")}
    for name, home in homes.items():
        module = modules.setdefault(f"nets.{home}", ModuleType(f"nets.{home}"))
        made[name] = type(name, (nn.Module,), {"__module__": module.__name__})
        setattr(module, name, made[name])
    before = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        yield made
    finally:
        for name, module_before in before.items():
            if module_before is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module_before


def write_motion(path: Path, *, frames: int = 8, width: int = 156, seed: int = 0) -> Path:
    """Write a motion as AMASS has them: someone sways, and return ``path``."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, width)
    along = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    np.savez(
        path,
        poses=0.4 * np.sin(along[:, None] + phase[None]),
        trans=np.stack([0.1 * np.sin(along), 0 * along, 0.1 * np.cos(along)], axis=1),
        betas=rng.normal(size=16),
        mocap_framerate=np.array(30.0),
        gender=np.array("neutral"),
    )
    return path

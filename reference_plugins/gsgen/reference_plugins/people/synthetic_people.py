"""Writes synthetic checkpoints of avatars in the layouts of their training code.

Gaussians are on a body of tubes, coloured as skin and clothes; networks add slight noise.
"""

__all__ = ["write_gauhuman", "write_lhm", "write_r3"]

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.formats import Splats, write_ply
from gsgen.formats.shared.quantities import SH_C0
from gsgen.reference_plugins.bodies.body_models import Body, read_body
from gsgen.reference_plugins.bodies.rest_pose import big_pose, posed_vertices
from gsgen.reference_plugins.bodies.synthetic_body import (
    PersonOptions,
    body_arrays,
    clothing_colors,
    write_body,
)
from gsgen.reference_plugins.writing.random_layers import random_linear
from gsgen.reference_plugins.writing.run_files import write_cfg_args, write_columns

_OPTIONS_WITHOUT_POSE_NETS = PersonOptions()
_OPTIONS_WITH_POSE_NETS = PersonOptions(nets=True)


def _assets(folder: Path, options: PersonOptions) -> Body:
    file = "models/smplx/SMPLX_NEUTRAL.npz" if options.kind == "smplx" else "SMPL_NEUTRAL.pkl"
    return read_body(write_body(folder / "assets" / file, options), options.joints)


def _splats(options: PersonOptions, body: Body) -> Splats:
    """Return Gaussians of the training pose near random vertices, coloured as skin and clothes."""
    rng = np.random.default_rng([options.seed, 2])
    count = options.count
    nearest_vertices = rng.integers(0, options.vertices, count)
    posed_points = posed_vertices(body, big_pose(body), np.zeros(0))
    position = posed_points[nearest_vertices] + rng.normal(0, 0.012, (count, 3))
    sh = rng.normal(0, 0.03, (count, (options.degree + 1) ** 2, 3))
    sh[:, 0] += (clothing_colors(body.template[nearest_vertices], options) - 0.5) / SH_C0
    return Splats(
        position=position.astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        log_scale=rng.normal(-4.2, 0.3, (count, 3)).astype(np.float32),
        logit_opacity=rng.normal(2, 1, count).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def write_gauhuman(folder: Path, options: PersonOptions = _OPTIONS_WITHOUT_POSE_NETS) -> Path:
    """Write a checkpoint of GauHuman with a body model in ``assets``, and return the folder."""
    cfg = {"smpl_type": options.kind, "actor_gender": "neutral", "sh_degree": 3}
    write_cfg_args(folder, cfg | {"motion_offset_flag": options.nets})
    body = _assets(folder, options)
    iteration_folder = folder / "point_cloud/iteration_1200"
    iteration_folder.mkdir(parents=True, exist_ok=True)
    write_ply(iteration_folder / "point_cloud.ply", _splats(options, body))
    if options.nets:
        pose, weights = _pose_nets(options)
        path = folder / "mlp_ckpt/iteration_1200/ckpt.pth"
        path.parent.mkdir(parents=True, exist_ok=True)
        state = {"iter": 1200, "pose_decoder": pose, "lweight_offset_decoder": weights}
        torch.save(state, path)
    return folder


def _pose_nets(options: PersonOptions) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    noise = torch.Generator().manual_seed(options.seed)
    rotation_size, width = 3 * (options.joints - 1), options.width
    pose: dict[str, Tensor] = {}
    for index, (inputs, outputs) in enumerate(
        [(rotation_size, width), (width, width), (width, rotation_size)]
    ):
        output_gain = 0.05 if index == 2 else 1.0
        pose |= random_linear(f"block_mlps.{2 * index}", inputs, outputs, noise, output_gain)
    weights: dict[str, Tensor] = {}
    for index, inputs in enumerate([63, width, width, 63 + width]):
        weights |= random_linear(f"bw_linears.{index}", inputs, width, noise)
    weights |= random_linear("bw_fc", width, options.joints, noise, 0.3)
    conv_weights = {
        name: value[:, :, None] if value.ndim == 2 else value for name, value in weights.items()
    }
    return pose, conv_weights


def write_lhm(folder: Path, options: PersonOptions = _OPTIONS_WITHOUT_POSE_NETS) -> Path:
    """Write a synthetic LHM avatar with the files that it needs, and return the folder.

    The body is always an SMPL-X of 400 shape coefficients; ``kind`` and ``shapes`` are ignored.
    """
    body = PersonOptions(
        count=options.count,
        kind="smplx",
        vertices=options.vertices,
        shapes=400,
        hands=True,
        seed=options.seed,
    )
    arrays = body_arrays(body)
    rng = np.random.default_rng([options.seed, 3])
    # Expressions move only the first third of the vertices.
    arrays["shapedirs"][options.vertices // 3 :, :, 300:] = 0
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "SMPLX_NEUTRAL.npz", **arrays)  # type: ignore[arg-type]
    nearest_vertices = arrays["v_template"][rng.integers(0, options.vertices, options.count)]
    samples = (nearest_vertices + rng.normal(0, 0.01, nearest_vertices.shape)).astype(np.float32)
    points = folder / "pretrained_models/dense_sample_points/1_40000.ply"
    write_columns(points, {axis: samples[:, index] for index, axis in enumerate("xyz")})
    prior_file = folder / "pretrained_models/voxel_grid/human_prior_constrain.npz"
    prior_file.parent.mkdir(parents=True, exist_ok=True)
    np.savez(prior_file, masks=(rng.random(options.vertices) < 0.3).astype(np.float32))
    torch.save(
        _lhm_tensors(samples, clothing_colors(nearest_vertices, body), rng), folder / "avatar.pth"
    )
    return folder


def _lhm_tensors(
    samples: Float[np.ndarray, "n 3"], colors: Float[np.ndarray, "n 3"], rng: np.random.Generator
) -> list[Any]:
    count = len(samples)
    quaternion = rng.normal(size=(count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    neutral_transforms = np.tile(np.eye(4), (55, 1, 1))
    left_singular_vectors, _, right_singular_vectors = np.linalg.svd(
        np.eye(3) + rng.normal(0, 0.03, (55, 3, 3))
    )
    neutral_transforms[:, :3, :3] = (
        left_singular_vectors @ right_singular_vectors
    )  # the nearest rotations
    neutral_transforms[:, :3, 3] = rng.normal(0, 0.01, (55, 3))
    arrays = [
        rng.normal(0, 0.005, (count, 3)),
        samples,
        np.clip(colors + rng.normal(0, 0.03, (count, 3)), 0, 1),
        rng.uniform(0.5, 1, (count, 1)),
        rng.uniform(0.005, 0.025, (count, 3)),
        quaternion,
        neutral_transforms,
        rng.normal(size=10),
    ]
    return [
        *(torch.from_numpy(array.astype(np.float32)) for array in arrays),
        np.float64(7.3),
        True,
    ]


def write_r3(folder: Path, options: PersonOptions = _OPTIONS_WITH_POSE_NETS) -> Path:
    """Write a checkpoint of R3-Avatar trained on ZJU-MoCap, and return the folder."""
    cfg = {"smpl_type": options.kind, "actor_gender": "neutral", "sh_degree": 3}
    write_cfg_args(folder, cfg | {"source_path": "/data/zju_mocap/my_377"})
    body = _assets(folder, options)
    noise = torch.Generator().manual_seed(options.seed + 1)
    with _training_classes() as classes:
        fields = _r3_fields(options, _splats(options, body), noise, classes)
        torch.save((fields, 60000), folder / "chkpnt60000.pth")
    return folder


def _r3_fields(
    options: PersonOptions,
    splats: Splats,
    noise: torch.Generator,
    classes: Mapping[str, type[nn.Module]],
) -> tuple[Any, ...]:
    xyz, sh = torch.from_numpy(splats.position), torch.from_numpy(splats.sh)
    pose, weights = _pose_nets(options)
    grids = nn.ModuleList()
    for factor in (1, 2, 4):
        sizes = [*(factor * n for n in options.resolution[:3]), options.resolution[3]]
        planes = [
            0.8 + 0.4 * torch.randn((1, options.channels, sizes[b], sizes[a]), generator=noise)
            for a, b in combinations(range(4), 2)
        ]
        grids.append(nn.ParameterList(planes))
    width = options.width
    decoder = random_linear("linear.0", 3 * options.channels, width, noise)
    decoder |= random_linear("linear.1", width, width, noise)
    heads = {"warp": (3, 0.02), "opacity": (1, 0.7), "rotation": (4, 1.0), "scaling": (3, 0.03)}
    for name, (outputs, output_gain) in heads.items():
        decoder |= random_linear(f"gaussian_{name}", width, outputs, noise, output_gain)
    decoder["gaussian_opacity.bias"] += 2  # most Gaussians are opaque
    decoder["gaussian_scaling.bias"] += 0.11  # its square is the scale
    margin = 0.05
    low, high = (xyz.amin(dim=0) + margin, xyz.amax(dim=0) + margin)  # some Gaussians are outside
    parameters = [
        nn.Parameter(values)
        for values in (xyz, sh[:, :1], sh[:, 1:], torch.from_numpy(splats.log_scale))
    ]
    return (
        *(3, *parameters, nn.Parameter(torch.from_numpy(splats.rotation))),
        nn.Parameter(torch.from_numpy(splats.logit_opacity)[:, None]),
        *(torch.zeros(0), torch.zeros(len(xyz), 1), torch.zeros(len(xyz), 1)),
        # NumPy scalars, as in checkpoints that training saves.
        *({"state": {}, "param_groups": [{"lr": np.float64(1.6e-6)}]}, np.float64(1.1)),
        _with_tensors(classes["BodyPoseRefiner"](), pose),
        _with_tensors(classes["LBSOffsetDecoder"](), weights),
        *(nn.Parameter(torch.stack([low, high])), [{"resolution": list(options.resolution)}]),
        *(grids, 3 * options.channels, _with_tensors(classes["GaussianDecoder"](), decoder)),
    )


def _with_tensors(module: nn.Module, state: Mapping[str, Tensor]) -> nn.Module:
    """Add the tensors of a state dict to a module, in submodules named after their keys."""
    for path, value in state.items():
        *parents, name = path.split(".")
        submodule = module
        for parent in parents:
            if parent not in dict(submodule.named_children()):
                submodule.add_module(parent, nn.ModuleList())
            submodule = submodule.get_submodule(parent)
        submodule.register_parameter(name, nn.Parameter(value))
    return module


@contextmanager
def _training_classes() -> Iterator[dict[str, type[nn.Module]]]:
    """Define classes whose pickles have the class names of R3-Avatar's training code."""
    module_files = {
        "GaussianDecoder": "gaussian_decoder",
        "BodyPoseRefiner": "mlp_delta_body_pose",
        "LBSOffsetDecoder": "mlp_delta_weight_lbs",
    }
    classes, modules = {}, {"nets": ModuleType("nets")}
    for name, module_file in module_files.items():
        module = modules.setdefault(f"nets.{module_file}", ModuleType(f"nets.{module_file}"))
        classes[name] = type(name, (nn.Module,), {"__module__": module.__name__})
        setattr(module, name, classes[name])
    old_modules = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        yield classes
    finally:
        for name, module_before in old_modules.items():
            if module_before is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module_before

"""Writes synthetic checkpoints of avatars in the layouts of their training code.

Gaussians are on a body of tubes, coloured as skin and clothes; networks add slight noise.
"""

__all__ = ["write_gart", "write_gauhuman", "write_lhm", "write_r3"]

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
import yaml
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.formats import Splats, write_ply
from gsgen.formats.shared.quantities import SH_C0
from gsgen.reference_plugins.bodies.body_models import Body, read_body
from gsgen.reference_plugins.bodies.rest_pose import (
    big_pose,
    joint_transforms,
    joints_of,
    posed_vertices,
    rodrigues,
)
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
# GART's canonical poses: joint → its rotation around z.
_GART_POSES: Mapping[str, Mapping[int, float]] = {
    "t_pose": {},
    "da_pose": {1: np.pi / 6, 2: -np.pi / 6},
    "a_pose": {1: 0.2, 2: -0.2, 16: -0.8, 17: 0.8},
}


def _assets(folder: Path, options: PersonOptions) -> Body:
    file = "models/smplx/SMPLX_NEUTRAL.npz" if options.kind == "smplx" else "SMPL_NEUTRAL.pkl"
    return read_body(write_body(folder / "assets" / file, options), options.joints)


def _splats(options: PersonOptions, body: Body, pose: Float[np.ndarray, "j 3"]) -> Splats:
    """Return Gaussians of a body in a pose, near random vertices, coloured as skin and clothes."""
    rng = np.random.default_rng([options.seed, 2])
    count = options.count
    nearest_vertices = rng.integers(0, options.vertices, count)
    posed_points = posed_vertices(body, pose, np.zeros(0))
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
    write_ply(iteration_folder / "point_cloud.ply", _splats(options, body, big_pose(body)))
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


def write_gart(
    folder: Path,
    options: PersonOptions = _OPTIONS_WITHOUT_POSE_NETS,
    *,
    bones: int = 4,
    frames: int = 0,
    memory: str = "voxel",
    corrects: bool = True,
    resolution: int = 12,
    pose: str = "da_pose",
    scales: tuple[float, float] = (0.0, 1.0),
    noise: float = 0.1,
) -> Path:
    """Write a synthetic GART avatar in the layout of its solver, and return the folder.

    Args:
        folder: Where ``model.pth`` and ``people.yaml`` are written.
        options: Sizes and seed; ``degree`` is that of the spherical harmonics, 0 to 4.
        bones: Number of additional bones.
        frames: Training frames that move the bones; with 0 a network of the pose does.
        memory: Where corrections of the skinning weights are: ``voxel`` or ``point``.
        corrects: Whether the joints' weights are corrected.
        resolution: Cells of the grid along x and y; a quarter of them along z.
        pose: The canonical pose: ``t_pose``, ``da_pose`` or ``a_pose``.
        scales: The smallest and the largest standard deviation.
        noise: Deviation of the bones' weights; a fifth of it that of corrections.
    """
    body = read_body(write_body(folder / "body.pkl", options), options.joints)
    (folder / "body.pkl").unlink()  # the state dict holds its joints
    random = torch.Generator().manual_seed(options.seed + 2)
    canonical = np.zeros((body.joints, 3))
    for joint, angle in _GART_POSES[pose].items():
        canonical[joint, 2] = angle
    splats, (low, high) = _splats(options, body, canonical), scales
    share = (np.exp(splats.log_scale.astype(np.float64)) - low) / (high - low)
    count, is_voxel = options.count, memory == "voxel"
    sh = splats.sh.reshape(count, -1)
    own_weights = (
        noise
        / 5
        * torch.randn((count, 0 if is_voxel or not corrects else body.joints), generator=random)
    )
    own_bones = torch.randn((count, 0 if is_voxel else bones), generator=random)
    state = {
        "_xyz": torch.from_numpy(splats.position),
        "_rotation": torch.from_numpy(splats.rotation),
        "_scaling": torch.logit(torch.from_numpy(share).clamp(1e-3, 1 - 1e-3)).float(),
        "_opacity": torch.from_numpy(splats.logit_opacity)[:, None],
        "_features_dc": torch.from_numpy(sh[:, :3].copy()),
        "_features_rest": torch.from_numpy(sh[:, 3:].copy()),
        "_w_correction_dc": own_weights,
        "_w_correction_rest": noise * own_bones,
        "_features_localcode": torch.zeros(count, 0),
        "xyz_gradient_accum": torch.zeros(count),
        "xyz_gradient_denom": torch.zeros(count, dtype=torch.int64),
        "max_radii2D": torch.zeros(count),
        **_gart_template(body, canonical, resolution),
        **_gart_bones(options, bones, frames, random),
    }
    grid = state["template.voxel_deformer.lbs_voxel_base"]
    if is_voxel and corrects:
        correction = noise / 5 * torch.randn(grid.shape, generator=random)
        state["template.voxel_deformer.voxel_w_correction"] = correction
    if is_voxel and bones:
        bone_weights = torch.randn((1, bones, *grid.shape[2:]), generator=random)
        state["template.voxel_deformer.additional_correction"] = noise * bone_weights
    profile = {
        "CANO_POSE_TYPE": pose,
        "VOXEL_DEFORMER_RES": resolution,
        "W_CORRECTION_FLAG": corrects,
        "W_REST_DIM": bones,
        "W_REST_MODE": "delta-list" if frames else "pose-mlp",
        "W_MEMORY_TYPE": memory,
        "MAX_SCALE": high,
        "MIN_SCALE": low,
        "MAX_SPH_ORDER": options.degree,
    }
    (folder / "people.yaml").write_text(yaml.safe_dump(profile, sort_keys=False), "utf-8")
    torch.save(state, folder / "model.pth")
    return folder


def _gart_template(
    body: Body, canonical: Float[np.ndarray, "j 3"], resolution: int
) -> dict[str, Tensor]:
    """Return the buffers of a body in the canonical pose, with a grid of its skinning weights."""
    from scipy.spatial import cKDTree

    joints = joints_of(body, np.zeros(0))
    rotations = rodrigues(canonical)
    transforms = np.tile(np.eye(4), (body.joints, 1, 1))
    transforms[:, :3] = joint_transforms(rotations, joints, body.parents)
    vertices = posed_vertices(body, canonical, np.zeros(0))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    ratio, offset, scale = 4.0, (low + high) / 2, 1.2 * (high - low).max() / 2
    cells = (resolution // 4, resolution, resolution)
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, size) for size in cells), indexing="ij")
    points = np.stack([x, y, z / ratio], axis=-1).reshape(-1, 3) * scale + offset
    distances, nearest_vertices = cKDTree(vertices).query(points, k=8)
    nearness = 1 / distances.clip(1e-4)
    nearness /= nearness.sum(axis=1, keepdims=True)
    weights = np.einsum("nk,nkj->jn", nearness, body.weights[nearest_vertices])
    layer = "template._template_layer"
    arrays = {
        "template.init_beta": np.zeros(10),
        "template.canonical_pose": rotations,
        "template.A0_inv": np.linalg.inv(transforms),
        "template.J_canonical": joints[None],
        "template.j0_t": joints[0],
        f"{layer}.v_template": body.template,
        f"{layer}.lbs_weights": body.weights,
        "template.voxel_deformer.ratio": np.array(ratio),
        "template.voxel_deformer.global_scale": np.array(1.2),
        "template.voxel_deformer.scale": np.array(scale),
        "template.voxel_deformer.offset": offset[None, None],
        "template.voxel_deformer.lbs_voxel_base": weights.reshape(1, body.joints, *cells),
        "template.voxel_deformer.grid_denorm": points[None],
    }
    state = {name: torch.from_numpy(array.astype(np.float32)) for name, array in arrays.items()}
    return state | {f"{layer}.parents": torch.tensor(body.parents)}


def _gart_bones(
    options: PersonOptions, bones: int, frames: int, noise: torch.Generator
) -> dict[str, Tensor]:
    """Return the network of the pose that moves the bones, or their steps in training frames."""
    if not bones:
        return {}
    if frames:
        shape = (frames, bones, 3)
        return {
            "add_bones.dr_list": 0.1 * torch.randn(shape, generator=noise),
            "add_bones.dt_list": 0.02 * torch.randn(shape, generator=noise),
        }
    state: dict[str, Tensor] = {}
    inputs = 3 * (options.joints - 1)
    for index in range(2):
        state |= random_linear(f"add_bones.mlp_layers.{index}.0", inputs, options.width, noise)
        inputs = options.width
    head = random_linear("head", inputs, 7 * bones, noise, 0.1)["head.weight"]
    return state | {"add_bones.mlp_output_head.weight": head}


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
        fields = _r3_fields(options, _splats(options, body, big_pose(body)), noise, classes)
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

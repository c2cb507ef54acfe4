"""What GART, GauHuman, LHM and R3-Avatar compute, written out plainly in float64, body by body.

Each function follows the formulas of its method, and shares no code with our generators: whole
bodies are skinned, chains are loops, matrices are inverted, grids are sampled.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
import yaml
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.bodies.pose_networks import PoseNets
from gsgen.reference_plugins.people.gauhuman_checkpoint import GauHumanCheckpoint
from gsgen.reference_plugins.people.lhm_checkpoint import Face, LHMCheckpoint
from gsgen.reference_plugins.people.r3_avatar_checkpoint import R3Checkpoint
from support.checkpoints.plugin_oracles import ExpectedGaussians


@dataclass
class PoseInputs:
    """What moves one body."""

    pose: np.ndarray
    turn: np.ndarray
    shift: np.ndarray
    shape: np.ndarray
    expression: np.ndarray | None = None
    pose_id: int = 0


def turns_of(pose: np.ndarray) -> np.ndarray:
    rotations: np.ndarray = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix()
    return rotations


def chain(body: Body, turns: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return 4×4 transforms of the joints, the rest pose taken off."""
    shaped = body.template + body.shape_dirs[:, :, : len(shape)] @ shape
    joints = body.regressor @ shaped
    world: list[np.ndarray] = []
    for joint, parent in enumerate(body.parents):
        local = np.eye(4)
        local[:3, :3] = turns[joint]
        if parent < 0:
            local[:3, 3] = joints[joint]
            world.append(local)
        else:
            local[:3, 3] = joints[joint] - joints[parent]
            world.append(world[parent] @ local)
    transforms = []
    for joint, transform in enumerate(world):
        back = np.eye(4)
        back[:3, 3] = -joints[joint]
        transforms.append(transform @ back)
    return np.stack(transforms)


def skinned(transforms: np.ndarray, weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    blend = np.einsum("nj,jab->nab", weights, transforms)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], 1)
    return np.einsum("nab,nb->na", blend, homogeneous)[:, :3]


def big_pose(body: Body) -> np.ndarray:
    """Return the big pose."""
    pose = np.zeros((body.joints, 3))
    for joint, degrees in ((1, 45.0), (2, -45.0)):
        pose[joint, 2] = np.radians(degrees)
    pose[7, 2], pose[8, 2] = np.radians(-30.0), np.radians(30.0)
    if body.joints == 55 and body.hand_mean is not None:
        pose[25:] = body.hand_mean.reshape(30, 3)
    return pose


def blendshapes(body: Body, turns: np.ndarray) -> np.ndarray:
    feature = np.concatenate([(turn - np.eye(3)).ravel() for turn in turns[1:]])
    return np.einsum("vap,p->va", body.pose_dirs, feature)


def refined(nets: PoseNets | None, pose: np.ndarray) -> np.ndarray:
    """Return the turns of joints, corrected by the network."""
    turns = turns_of(pose)
    if nets is None:
        return turns
    x = torch.from_numpy(pose[1:].reshape(1, -1))
    for index, (weight, bias) in enumerate(nets.pose):
        x = F.linear(x if index == 0 else torch.relu(x), weight.double(), bias.double())
    offsets = []
    for vector in x.reshape(-1, 3).numpy():
        angle = np.sqrt(1e-5 + (vector**2).sum())
        axis = vector / angle
        cross = np.cross(
            np.eye(3), axis
        )  # row j is e_j × axis, which is row j of the matrix [axis]×
        c, s = np.cos(angle), np.sin(angle)
        outer_product = np.outer(axis, axis)
        # Written for a unit axis; this one is not quite: its diagonal is r² + (1 − r²) c.
        rotation = outer_product * (1 - c) + s * cross
        rotation[np.diag_indices(3)] = axis**2 + (1 - axis**2) * c
        offsets.append(rotation)
    return np.concatenate([turns[:1], turns[1:] @ np.stack(offsets)])


def corrected(nets: PoseNets | None, weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return skinning weights of points."""
    if nets is None:
        return weights
    x = torch.from_numpy(points.astype(np.float64))
    parts = [x]
    for octave in range(10):
        parts += [torch.sin(x * 2**octave), torch.cos(x * 2**octave)]
    embedded = torch.cat(parts, 1)
    h = embedded
    for index, (weight, bias) in enumerate(nets.weights):
        if index == 3:
            h = torch.cat([embedded, h], 1)
        h = F.linear(h, weight.double(), bias.double())
        if index < 4:
            h = torch.relu(h)
    logits = torch.from_numpy(np.log(weights + 1e-9)) + h
    return np.asarray(torch.softmax(logits, 1))


def nearest(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - vertices[None], axis=2).argmin(1)


def followed(
    body: Body,
    nets: PoseNets | None,
    pose_inputs: PoseInputs,
    canonical: np.ndarray,
    moved: np.ndarray,
    covariance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Move Gaussians from the big pose: steps 1 to 7 of GauHuman."""
    big_pose_rotations = turns_of(big_pose(body))
    none = np.zeros(0)
    big_pose_transforms = chain(body, big_pose_rotations, none)
    vertices = skinned(
        big_pose_transforms, body.weights, body.template + blendshapes(body, big_pose_rotations)
    )
    vid = nearest(moved, vertices)
    weights = corrected(nets, body.weights[vid], canonical)
    blend = np.einsum("nj,jab->nab", weights, big_pose_transforms)
    back = np.linalg.inv(blend[:, :3, :3])
    point = np.einsum("nab,nb->na", back, moved - blend[:, :3, 3])
    turns = refined(nets, pose_inputs.pose)
    shaped = body.shape_dirs[:, :, : len(pose_inputs.shape)] @ pose_inputs.shape
    point += (blendshapes(body, turns) - blendshapes(body, big_pose_rotations) + shaped)[vid]
    transforms = chain(body, turns, pose_inputs.shape)
    posed_points = skinned(transforms, weights, point)
    world = posed_points @ np.linalg.inv(pose_inputs.turn) + pose_inputs.shift
    now = np.einsum("nj,jab->nab", weights, transforms)[:, :3, :3]
    whole = pose_inputs.turn @ now @ back
    return world, whole @ covariance @ whole.transpose(0, 2, 1)


def upper(matrix: np.ndarray) -> np.ndarray:
    a, b = np.triu_indices(3)
    return matrix[:, a, b]


def covariances(scale: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    turn = Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix()
    return np.asarray(turn @ (scale[:, :, None] ** 2 * turn.transpose(0, 2, 1)))


def gauhuman(read: GauHumanCheckpoint, pose_inputs: PoseInputs) -> ExpectedGaussians:
    """skhu101/GauHuman: `scene/gaussian_model.py` and `gaussian_renderer`."""
    cloud = read.canonical
    xyz = cloud.position.double().numpy()
    scale = np.exp(cloud.log_scale.double().numpy())
    sigma = covariances(scale, cloud.rotation.double().numpy())
    position, covariance = followed(read.body, read.nets, pose_inputs, xyz, xyz, sigma)
    opacity = torch.sigmoid(cloud.logit_opacity.double()).numpy()[:, 0]
    color = cloud.sh.flatten(1).double().numpy()
    return ExpectedGaussians(np.ones(len(xyz), bool), position, opacity, upper(covariance), color)


def lhm(read: LHMCheckpoint, face: Face | None, pose_inputs: PoseInputs) -> ExpectedGaussians:
    """aigc3d/LHM: `gs_renderer.py` and `smpl_x_voxel_dense_sampling.py`."""
    body, betas = read.body, read.betas.double().numpy()
    vid = nearest(read.samples, body.template)
    weights = body.weights[vid]
    point = read.position.double().numpy()
    if pose_inputs.expression is not None:
        dirs = body.shape_dirs[:, :, 300:400].copy()
        if face is not None:
            dirs[face.vertices] = face.dirs
        point = point + dirs[vid] @ pose_inputs.expression
    neutral = read.neutral.double().numpy()
    point = skinned(neutral, weights, point) + body.shape_dirs[vid][:, :, :10] @ betas
    transforms = chain(body, turns_of(pose_inputs.pose), betas)
    position = skinned(transforms, weights, point) + pose_inputs.shift
    whole = (
        np.einsum("nj,jab->nab", weights, transforms)[:, :3, :3]
        @ np.einsum("nj,jab->nab", weights, neutral)[:, :3, :3]
    )
    turn = np.stack([quaternion_of(matrix) for matrix in whole])
    turn[read.stiff[vid]] = (1, 0, 0, 0)
    turned = Rotation.from_quat(np.roll(turn, -1, axis=1)).as_matrix()
    scale, quaternion = read.scale.double().numpy(), read.rotation.double().numpy()
    sigma = turned @ covariances(scale, quaternion) @ turned.transpose(0, 2, 1)
    opacity = read.opacity.double().numpy()[:, 0]
    rgb = read.rgb.double().numpy()
    return ExpectedGaussians(np.ones(len(point), bool), position, opacity, upper(sigma), rgb)


def quaternion_of(m: np.ndarray) -> np.ndarray:
    """Return pytorch3d's quaternion of a matrix that need not be a rotation, normalised."""
    squares = np.maximum(
        0,
        [
            1 + m[0, 0] + m[1, 1] + m[2, 2],
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
        ],
    )
    size = np.sqrt(squares)
    candidates = [
        [size[0] ** 2, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], size[1] ** 2, m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], size[2] ** 2, m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], size[3] ** 2],
    ]
    best = int(size.argmax())
    quaternion = np.array(candidates[best]) / (2 * max(size[best], 0.1))
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def decoded(read: R3Checkpoint, pose_id: int) -> dict[str, np.ndarray]:
    """Return what R3-Avatar's decoder says of each Gaussian at the time of a training pose."""
    xyz = read.canonical.position.double()
    low, high = read.aabb.double()
    scaled = (xyz - low) * 2 / (high - low) - 1
    time = torch.full((len(xyz), 1), pose_id / read.origin - 1, dtype=torch.float64)
    coordinates = torch.cat([scaled, time], 1)
    features = []
    for planes in read.grids:
        product = torch.ones(1, dtype=torch.float64)
        pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
        for plane, pair in zip(planes, pairs, strict=True):
            grid = coordinates[None, None][..., list(pair)]
            sampled = F.grid_sample(
                plane.double()[None], grid, padding_mode="border", align_corners=True
            )
            product = product * sampled[0, :, 0].t()
        features.append(product)
    h = torch.cat(features, 1)
    for weight, bias in read.inner:
        h = torch.relu(F.linear(h, weight.double(), bias.double()))
    outputs = {
        name: F.linear(h, weight.double(), bias.double()).numpy()
        for name, (weight, bias) in read.heads.items()
    }
    return outputs | {"scaling": outputs["scaling"] ** 2}


def r3(read: R3Checkpoint, pose_inputs: PoseInputs) -> ExpectedGaussians:
    """Yifever20002/R3Avatars: `gaussian_renderer` of a pose that training saw."""
    return r3_posed(read, pose_inputs, decoded(read, pose_inputs.pose_id))


def r3_novel(read: R3Checkpoint, pose_inputs: PoseInputs, pose_ids: list[int]) -> ExpectedGaussians:
    """Yifever20002/R3Avatars: `render_nops`, with a training pose for each part of the body."""
    decoded_looks = [decoded(read, pose_id) for pose_id in pose_ids]
    canonical = read.canonical.position.double().numpy()
    transforms = chain(read.body, turns_of(big_pose(read.body)), np.zeros(0))
    template = read.body.template + blendshapes(read.body, turns_of(big_pose(read.body)))
    vertices = skinned(transforms, read.body.weights, template)
    vid = nearest(canonical + decoded_looks[-1]["warp"], vertices)
    weights = corrected(read.nets, read.body.weights[vid], canonical)
    legs = ([1, 4, 7, 10], [2, 5, 8, 11])
    if read.body.joints == 24:
        remaining = ([0, 3, 6, 9, 12, 15], [13, 16, 18, 20, 22], [14, 17, 19, 21, 23])
    else:
        left, right = [13, 16, 18, 20, *range(25, 40)], [14, 17, 19, 21, *range(40, 55)]
        remaining = ([0, 3, 6, 9, 12, 15, 22, 23, 24], left, right)
    shares = np.stack([weights[:, part].sum(axis=1) for part in (*legs, *remaining)], axis=1)
    mixed = {
        name: np.einsum(
            "np,pnc->nc", shares, np.stack([decoded_look[name] for decoded_look in decoded_looks])
        )
        for name in decoded_looks[0]
    }
    return r3_posed(read, pose_inputs, mixed)


def r3_posed(
    read: R3Checkpoint, pose_inputs: PoseInputs, outputs: dict[str, np.ndarray]
) -> ExpectedGaussians:
    """Move the Gaussians of R3-Avatar, whose attributes are decoded already."""
    canonical = read.canonical.position.double().numpy()
    sigma = covariances(outputs["scaling"], outputs["rotation"])
    moved = canonical + outputs["warp"]
    position, covariance = followed(read.body, read.nets, pose_inputs, canonical, moved, sigma)
    opacity = 1 / (1 + np.exp(-outputs["opacity"][:, 0]))
    color = read.canonical.sh.flatten(1).double().numpy()
    return ExpectedGaussians(
        np.ones(len(canonical), bool), position, opacity, upper(covariance), color
    )


def gart(folder: Path, pose_inputs: PoseInputs, eye: np.ndarray) -> ExpectedGaussians:
    """JiahuiLei/GART: `lib_gart/model.py`, and the colours of `lib_render/gauspl_renderer.py`.

    Of `pose_inputs`, `pose`, `shift` and `pose_id`, the training frame, count.
    """
    saved = torch.load(folder / "model.pth", weights_only=True)
    state = {name: value.double().numpy() for name, value in saved.items()}
    profile = yaml.safe_load((folder / "people.yaml").read_text())
    grid = "template.voxel_deformer"
    xyz, parents = state["_xyz"], state["template._template_layer.parents"].astype(int)

    cells = state[f"{grid}.lbs_voxel_base"] + state.get(f"{grid}.voxel_w_correction", 0)
    cells = (
        np.concatenate([cells, state[f"{grid}.additional_correction"]], 1)[0]
        if (f"{grid}.additional_correction" in state)
        else cells[0]
    )
    unit = (xyz - state[f"{grid}.offset"][0]) / state[f"{grid}.scale"]
    unit[:, 2] *= state[f"{grid}.ratio"]
    index = (unit[:, ::-1].T + 1) / 2 * (np.array(cells.shape[1:]) - 1)[:, None]
    weights = np.stack([map_coordinates(cell, index, order=1, mode="nearest") for cell in cells], 1)
    if state["_w_correction_dc"].shape[1]:
        weights[:, :24] += state["_w_correction_dc"]
    weights = np.concatenate([weights, state["_w_correction_rest"]], 1)

    turns, joints = turns_of(pose_inputs.pose), state["template.J_canonical"][0]
    world: list[np.ndarray] = []
    for joint, parent in enumerate(parents):
        local = np.eye(4)
        local[:3, :3] = turns[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if joint else 0)
        world.append(world[parent] @ local if joint else local)
    transforms = []
    for joint, transform in enumerate(world):
        back = np.eye(4)
        back[:3, 3] = -joints[joint]
        transforms.append(transform @ back @ state["template.A0_inv"][joint])
    about_root = np.eye(4)
    about_root[:3, :3] = turns[0]
    about_root[:3, 3] = (np.eye(3) - turns[0]) @ state["template.j0_t"]
    transforms += [about_root @ bone for bone in _gart_bones(state, pose_inputs)]

    blend = np.einsum("nj,jab->nab", weights, np.stack(transforms))
    position = np.einsum("nab,nb->na", blend[:, :3, :3], xyz) + blend[:, :3, 3] + pose_inputs.shift
    quaternion = state["_rotation"]
    axes = blend[:, :3, :3] @ Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix()
    low, high = profile["MIN_SCALE"], profile["MAX_SCALE"]
    scale = low + (high - low) / (1 + np.exp(-state["_scaling"]))
    root = axes * scale[:, None]
    seen = np.einsum("nab,na->nb", axes, position - eye)
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    sh = np.concatenate([state["_features_dc"], state["_features_rest"]], 1).reshape(
        len(xyz), -1, 3
    )
    rgb = np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", _harmonics(seen, sh.shape[1]), sh))
    opacity = 1 / (1 + np.exp(-state["_opacity"][:, 0]))
    covariance = upper(root @ root.transpose(0, 2, 1))
    return ExpectedGaussians(np.ones(len(xyz), bool), position, opacity, covariance, rgb)


def _gart_bones(state: dict[str, np.ndarray], pose_inputs: PoseInputs) -> list[np.ndarray]:
    """Return the additional bones: of the network, or chained up to a training frame."""
    if "add_bones.dr_list" in state:
        count = state["add_bones.dr_list"].shape[1]
        chained = [np.eye(4) for _ in range(count)]
        for frame in range(pose_inputs.pose_id + 1):
            for bone in range(count):
                step = np.eye(4)
                step[:3, :3] = turns_of(state["add_bones.dr_list"][frame, bone])[0]
                step[:3, 3] = state["add_bones.dt_list"][frame, bone]
                chained[bone] = chained[bone] @ step
        return chained
    if "add_bones.mlp_output_head.weight" not in state:
        return []
    x = pose_inputs.pose[1:].ravel()
    for layer in range(2):
        name = f"add_bones.mlp_layers.{layer}.0"
        x = state[f"{name}.weight"] @ x + state[f"{name}.bias"]
        x = np.where(x > 0, x, 0.01 * x)
    bones = []
    for w, *numbers in (state["add_bones.mlp_output_head.weight"] @ x).reshape(-1, 7):
        bone = np.eye(4)
        bone[:3, :3] = Rotation.from_quat([*numbers[:3], w + 1]).as_matrix()
        bone[:3, 3] = numbers[3:]
        bones.append(bone)
    return bones


def _harmonics(direction: np.ndarray, count: int) -> np.ndarray:
    """Return the real spherical harmonics with the sign of Condon and Shortley, as 3DGS has it."""
    polar, azimuth = np.arccos(direction[:, 2]), np.arctan2(direction[:, 1], direction[:, 0])
    columns = []
    for degree in range(int(count**0.5)):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), polar, azimuth)
            part = value.imag if order < 0 else value.real
            columns.append(part * (1 if order == 0 else np.sqrt(2)))
    return np.stack(columns, 1)

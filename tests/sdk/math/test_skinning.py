import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gsgen.sdk import GeneratorInvalid, math

SMPL = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
CHAINS = {
    "one joint": [-1],
    "a line": [-1, *range(16)],
    "backwards": [1, 2, 3, 4, -1],
    "two roots": [-1, 0, 1, -1, 3],
    "smpl": SMPL,
    "unsigned": [2**32 - 1, 0, 1],
}


def chained(turns: np.ndarray, joints: np.ndarray, parents: list[int]) -> np.ndarray:
    """The loop over joints, in float64, with the rest pose taken out: [J, 3, 4]."""
    results: dict[int, np.ndarray] = {}

    def of(joint: int) -> np.ndarray:
        parent = parents[joint] if parents[joint] < len(parents) else -1
        if joint not in results:
            local = np.eye(4)
            local[:3, :3] = turns[joint]
            local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
            results[joint] = of(parent) @ local if parent >= 0 else local
        return results[joint]

    whole = np.stack([of(joint) for joint in range(len(parents))])
    whole[:, :3, 3] -= np.einsum("jab,jb->ja", whole[:, :3, :3], joints)
    return whole[:, :3]


@pytest.mark.parametrize("name", CHAINS)
def test_kinematic_chain_agrees_with_a_loop(name: str) -> None:
    parents = CHAINS[name]
    rng = np.random.default_rng(len(parents))
    count = len(parents)
    vectors = rng.normal(0, 1, (count, 3)).astype(np.float32)
    joints = rng.normal(0, 0.4, (count, 3)).astype(np.float32)
    move = rng.normal(size=3).astype(np.float32)
    expected = chained(Rotation.from_rotvec(vectors).as_matrix(), joints, parents)
    expected[:, :, 3] += move
    turns = math.axis_angle_to_matrix(torch.from_numpy(vectors))
    actual = math.skinning_transforms(
        turns, torch.from_numpy(joints), parents, torch.from_numpy(move)
    )
    np.testing.assert_allclose(actual.numpy(), expected, atol=1e-5)
    double_precision = math.skinning_transforms(
        turns.double(), torch.from_numpy(joints).double(), parents
    )
    expected[:, :, 3] -= move
    np.testing.assert_allclose(double_precision.numpy(), expected, atol=1e-5)


def test_the_chain_of_smpl_has_the_posed_joints_and_the_relative_transforms() -> None:
    """As the formula of SMPL: matrices are chained, then the rest pose is taken out of each."""
    generator = torch.Generator().manual_seed(4)
    turns = math.axis_angle_to_matrix(torch.randn(24, 3, generator=generator)).double()
    joints = torch.randn(24, 3, generator=generator).double()
    parents = torch.tensor(SMPL)
    chain = torch.eye(4).double().repeat(24, 1, 1)
    chain[:, :3, :3], chain[:, :3, 3] = turns, joints
    chain[1:, :3, 3] -= joints[parents[1:]]
    for joint in range(1, 24):
        chain[joint] = chain[SMPL[joint]] @ chain[joint]
    rest = torch.cat([joints, torch.zeros(24, 1).double()], dim=1)
    relative = chain.clone()
    relative[:, :, 3] -= (chain @ rest[..., None])[..., 0]
    posed, transforms = math.smpl_chain(turns, joints, parents)
    torch.testing.assert_close(posed, chain[:, :3, 3])
    torch.testing.assert_close(transforms, relative)


def test_a_chain_in_float64_is_exact() -> None:
    rng = np.random.default_rng(0)
    turns = Rotation.from_rotvec(rng.normal(size=(24, 3))).as_matrix()
    joints = rng.normal(size=(24, 3))
    actual = math.skinning_transforms(torch.from_numpy(turns), torch.from_numpy(joints), SMPL)
    np.testing.assert_allclose(actual.numpy(), chained(turns, joints, SMPL), atol=1e-14)


def test_the_rest_pose_moves_nothing() -> None:
    joints = torch.randn(24, 3, generator=torch.Generator().manual_seed(1))
    result = math.skinning_transforms(torch.eye(3).expand(24, 3, 3), joints, SMPL)
    expected = torch.eye(4)[:3].expand(24, 3, 4)
    torch.testing.assert_close(result, expected, atol=1e-6, rtol=0)


def test_points_are_blended_as_by_the_oracle() -> None:
    rng = np.random.default_rng(6)
    points, weights = rng.normal(size=(50, 3)), rng.random((50, 5))
    weights /= weights.sum(axis=1, keepdims=True)
    transforms = rng.normal(size=(5, 3, 4))
    inputs = (torch.from_numpy(array.astype(np.float32)) for array in (points, weights, transforms))
    position, turn = math.skin(*inputs)
    blended = np.einsum("nj,jab->nab", weights, transforms)
    expected = np.einsum("nab,nb->na", blended[:, :, :3], points) + blended[:, :, 3]
    np.testing.assert_allclose(position.numpy(), expected, atol=2e-6)
    np.testing.assert_allclose(turn.numpy(), blended[:, :, :3], atol=1e-6)


@pytest.mark.parametrize(
    ("parents", "words"),
    [
        ([-1, 0], "3 rotations, 2 parents"),
        ([-1, 0, 3], "joint 2 has parent 3, expected -1 to 2"),
        ([-1, 2, 1], "joint 1 is its own ancestor"),
        ([-1, 0, 7], "joint 2 has parent 7, expected -1 to 2"),
        ([0, 0, 0], "joint 0 is its own ancestor"),
    ],
)
def test_invalid_joint_trees_are_refused(parents: list[int], words: str) -> None:
    with pytest.raises(GeneratorInvalid, match=words):
        math.skinning_transforms(torch.eye(3).expand(3, 3, 3), torch.zeros(3, 3), parents)

"""Every helper, exported and run by ONNX Runtime against torch; several in one live generator."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs, math
from support.models.captured import assert_captured

N, JOINTS = 40, 6
PARENTS = (-1, 0, 1, 1, 3, 0)


def seeded(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(sum(shape) + seed))


# What each helper is called with: x [N, 6], view and projection [4, 4], time [1].
Call = Callable[[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
PLANES = [seeded(3, 4 + i, 5 + i, seed=i) for i in range(6)]
TABLES = [seeded(64, 2), seeded(32, 2)]
CALLS: dict[str, Call] = {
    "safe_normalize": lambda x, v, p, t: math.safe_normalize(x[:, :3] * t),
    "quaternion_to_matrix": lambda x, v, p, t: math.quaternion_to_matrix(x[:, :4]),
    "matrix_to_quaternion": lambda x, v, p, t: math.matrix_to_quaternion(
        math.axis_angle_to_matrix(x[:, :3] * t)
    ),
    "quaternion_multiply": lambda x, v, p, t: math.quaternion_multiply(x[:, :4], x[:, 2:]),
    "axis_angle_to_matrix": lambda x, v, p, t: math.axis_angle_to_matrix(x[:, :3] * t),
    "covariance_upper": lambda x, v, p, t: math.covariance_upper(x[:, :3].exp(), x[:, 2:]),
    "covariance_matrix": lambda x, v, p, t: math.covariance_matrix(x),
    "upper_triangle": lambda x, v, p, t: math.upper_triangle(math.covariance_matrix(x)),
    "rotate_covariance": lambda x, v, p, t: math.rotate_covariance(x, v[:3, :3]),
    "transform_points": lambda x, v, p, t: math.transform_points(v[:3, :3], x[:, :3]),
    "sh_from_channel_major": lambda x, v, p, t: math.sh_from_channel_major(
        torch.cat([x, x], dim=1)
    ),
    "sh_from_coefficient_major": lambda x, v, p, t: math.sh_from_coefficient_major(
        torch.cat([x, x], dim=1)
    ),
    "sh_from_ply": lambda x, v, p, t: math.sh_from_ply(x[:, :3], torch.cat([x, x[:, :3]], dim=1)),
    "sh_from_rgb": lambda x, v, p, t: math.sh_from_rgb(x[:, :3]),
    "sh_of_degree": lambda x, v, p, t: math.sh_of_degree(x[:, None, :3], 2),
    "camera_centre": lambda x, v, p, t: math.camera_centre(v),
    "frustum_mask": lambda x, v, p, t: math.frustum_mask(x[:, :3], v, p, x[:, 3].abs()),
    "keep_rows": lambda x, v, p, t: torch.cat(math.keep_rows((x[:, 0] > t).float(), 25)),
    "top_rows": lambda x, v, p, t: math.top_rows(x[:, 0] * t, 9),
    "to_unit_cube": lambda x, v, p, t: math.to_unit_cube(x[:, :3], v[0, :3], v[0, :3] + 3),
    "sample_plane": lambda x, v, p, t: math.sample_plane(
        PLANES[0], x[:, :2], align_corners=False, padding="zeros"
    ),
    "tri_plane": lambda x, v, p, t: math.tri_plane(PLANES[:3], x[:, :3]),
    "hash_grid": lambda x, v, p, t: math.hash_grid(TABLES, x[:, :3].sigmoid(), (3, 9)),
    "inverse_3x3": lambda x, v, p, t: math.inverse_3x3(v[:3, :3] + 3 * torch.eye(3)),
    "hex_plane": lambda x, v, p, t: math.hex_plane(PLANES, x[:, :3], t),
    "skinning_transforms": lambda x, v, p, t: math.skinning_transforms(
        math.axis_angle_to_matrix(x[:JOINTS, :3]), x[:JOINTS, 3:], PARENTS, x[0, :3]
    ),
    "smpl_chain": lambda x, v, p, t: torch.cat(
        [
            entry.reshape(JOINTS, -1)
            for entry in math.smpl_chain(
                math.axis_angle_to_matrix(x[:JOINTS, :3]), x[:JOINTS, 3:], PARENTS
            )
        ],
        dim=1,
    ),
    "skin": lambda x, v, p, t: torch.cat(
        [entry.reshape(N, -1) for entry in math.skin(x[:, :3], x, v[None, :3].expand(6, 3, 4))],
        dim=1,
    ),
}


class Everything(torch.nn.Module):
    def forward(
        self, x: torch.Tensor, v: torch.Tensor, p: torch.Tensor, t: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        return tuple(call(x, v, p, t) for call in CALLS.values())


@pytest.fixture(scope="module")
def session() -> onnxruntime.InferenceSession:
    example = (seeded(N, 6), seeded(4, 4), seeded(4, 4, seed=1), torch.full((1,), 0.5))
    program = torch.onnx.export(
        Everything().eval(),
        example,
        dynamo=True,
        verbose=False,
        optimize=False,  # matching patterns in a thousand nodes takes longer than all else
        opset_version=18,
        input_names=["x", "v", "p", "t"],
        output_names=list(CALLS),
    )
    assert program is not None
    return onnxruntime.InferenceSession(program.model_proto.SerializeToString())


def test_every_helper_is_listed() -> None:
    assert set(CALLS) == set(math.__all__)


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_the_exported_helper_gives_what_torch_gives(
    session: onnxruntime.InferenceSession, name: str
) -> None:
    for seed, time in ((7, 0.9), (8, -0.4), (9, 0.0)):  # the last is what norms divide by
        example = (
            seeded(N, 6, seed=seed),
            seeded(4, 4, seed=seed),
            seeded(4, 4, seed=seed + 1),
            torch.full((1,), time),
        )
        feeds = {key: entry.numpy() for key, entry in zip("xvpt", example, strict=True)}
        (actual,) = session.run([name], feeds)
        expected = CALLS[name](*example).numpy()
        if name == "keep_rows":  # rows behind the count may be any
            live = int(expected[-1])
            assert actual[-1] == live
            actual, expected = actual[:live], expected[:live]
        if name == "top_rows" and time == 0:
            continue  # all scores are equal
        assert actual.shape == expected.shape
        np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=5e-5)


class Ensemble(GaussianGenerator):
    """Skinned Gaussians with features of planes, culled and moved forward."""

    inputs = (inputs.view(), inputs.projection(), inputs.time(range=(-1, 1)), inputs.pose(JOINTS))
    family = "avatar"

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("rest", 0.4 * seeded(N, 3))
        self.register_buffer("weights", torch.softmax(3 * seeded(N, JOINTS), dim=1))
        self.register_buffer("joints", 0.3 * seeded(JOINTS, 3))
        self.register_buffer("rotation", seeded(N, 4))
        self.plane = torch.nn.Parameter(PLANES[0])

    def forward(
        self, view: torch.Tensor, proj: torch.Tensor, time: torch.Tensor, pose: torch.Tensor
    ) -> Gaussians:
        transforms = math.skinning_transforms(math.axis_angle_to_matrix(pose), self.joints, PARENTS)
        feature = math.sample_plane(self.plane, self.rest[:, :2] + 0.3 * time)
        position, turn = math.skin(self.rest + 0.05 * feature, self.weights, transforms)
        scale = torch.full((N, 3), 0.15) * torch.tensor([1.0, 0.5, 0.2])
        covariance = math.rotate_covariance(math.covariance_upper(scale, self.rotation), turn)
        towards = math.safe_normalize(position - math.camera_centre(view))
        mask = math.frustum_mask(position, view, proj, margin=-0.3)  # some go
        rows, count = math.keep_rows(mask, N)
        gaussians = Gaussians(
            position=position,
            opacity=torch.full((N,), 0.8),
            covariance=covariance,
            sh=math.sh_of_degree(math.sh_from_rgb(0.5 + 0.4 * towards), 1),
        )
        return gaussians.take(rows, count)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    path: Path = tmp_path_factory.mktemp("ensemble") / "m.onnx"
    settings = Settings(level=Level.LIVE)
    exported = export(Ensemble(), path, target="webgpu", settings=settings)
    assert exported.parity.holds
    return exported.report


def test_helpers_together_are_captured_and_replayed(report: Report) -> None:
    """No node on the CPU, a capture that is accepted, replays that follow their inputs."""
    assert_captured(report)
    # The negative margin cuts into the picture.
    assert [finding.rule for finding in report.findings] == ["GB008"]
    assert report.verdict == "conforms"

import numpy as np
import pytest
import torch

from gsgen.contract import geometry
from gsgen.sdk import math


@pytest.fixture
def quaternions() -> np.ndarray:
    rng = np.random.default_rng(2)
    made = rng.normal(size=(500, 4)) * np.exp(rng.normal(0, 4, (500, 1)))
    return made.astype(np.float32)


def test_rotation_matrices_are_those_of_the_oracle(quaternions: np.ndarray) -> None:
    seen = math.quaternion_to_matrix(torch.from_numpy(quaternions)).numpy()
    np.testing.assert_allclose(seen, geometry.rotation_matrix(quaternions), atol=2e-6)


def test_covariances_are_those_of_the_oracle(quaternions: np.ndarray) -> None:
    scale = np.exp(np.random.default_rng(3).normal(-3, 2, (500, 3))).astype(np.float32)
    seen = math.covariance_upper(
        torch.from_numpy(scale), torch.from_numpy(quaternions)
    ).numpy()
    wanted = geometry.covariance_upper(scale, quaternions)
    trace = wanted[:, [0, 3, 5]].sum(axis=1, keepdims=True)
    np.testing.assert_array_less(np.abs(seen - wanted) / trace, 2e-6)


def test_normalising_zero_gives_zero_and_a_finite_gradient() -> None:
    zero = torch.zeros(2, 3, requires_grad=True)
    made = math.safe_normalize(zero)
    made.sum().backward()
    assert made.tolist() == [[0, 0, 0], [0, 0, 0]]
    assert zero.grad is not None
    assert torch.isfinite(zero.grad).all()


@pytest.mark.parametrize("length", [1e-9, 1e-3, 1.0, 1e6, 1e18])
def test_normalising_keeps_the_direction_at_any_length(length: float) -> None:
    made = math.safe_normalize(torch.tensor([[3.0, 0.0, 4.0]]) * length)
    np.testing.assert_allclose(made.numpy(), [[0.6, 0.0, 0.8]], rtol=1e-5)


def test_the_guard_of_a_norm_survives_export(tmp_path: object) -> None:
    class Guarded(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return math.safe_normalize(x)

    import onnxruntime

    program = torch.onnx.export(
        Guarded().eval(), (torch.ones(2, 3),), dynamo=True, verbose=False
    )
    assert program is not None
    session = onnxruntime.InferenceSession(program.model_proto.SerializeToString())
    (made,) = session.run(
        None, {session.get_inputs()[0].name: np.zeros((2, 3), np.float32)}
    )
    assert made.tolist() == [[0, 0, 0], [0, 0, 0]]

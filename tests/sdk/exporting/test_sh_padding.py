"""Harmonics of degrees that a consumer does not take, as an export writes them."""

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs
from gsgen.sdk.exporting.sh_padding import padded_harmonics


class Glowing(GaussianGenerator):
    inputs = (inputs.time(),)

    def __init__(self, degree: int) -> None:
        super().__init__()
        self.sh = torch.linspace(-1, 1, 12 * (degree + 1) ** 2).reshape(4, -1, 3)

    def forward(self, time: Tensor) -> Gaussians:
        return Gaussians(
            position=time + torch.eye(4)[:, :3],
            opacity=torch.full((4,), 0.5),
            covariance=torch.tensor([[0.1, 0, 0, 0.1, 0, 0.1]]).expand(4, 6),
            sh=self.sh + 0 * time,
        )


@pytest.mark.parametrize(
    ("half", "target", "written"),
    [
        (False, "core", (0, 1, 2, 3)),
        (True, "core", (1, 1, 3, 3)),
        (False, "visionary", (3, 3, 3, 3)),
        (True, "visionary", (3, 3, 3, 3)),
    ],
)
def test_harmonics_are_filled_up_with_zeros_where_they_have_to_be(
    half: bool, target: str, written: tuple[int, ...]
) -> None:
    for degree, expected in enumerate(written):
        generator = Glowing(degree)
        with padded_harmonics(generator, half=half, target=target) as message:
            for _ in range(2):
                result = generator(torch.zeros(1)).sh
        coefficient_count = (degree + 1) ** 2
        assert result.shape == (4, (expected + 1) ** 2, 3)
        assert torch.equal(result[:, :coefficient_count], generator.sh)
        assert (result[:, coefficient_count:] == 0).all()
        assert len(message) == (expected != degree)
        assert torch.equal(generator(torch.zeros(1)).sh, generator.sh)


def test_a_model_says_the_degree_that_it_has(tmp_path: Path) -> None:
    generator = Glowing(2)
    path, settings = tmp_path / "glowing.onnx", Settings(level=Level.STATIC)
    exported = export(generator, path, dtype="float16", settings=settings)
    assert exported.notes == ("SH of degree 2 are written as degree 3: rows fill words",)
    color = exported.manifest.outputs.appearance
    assert color is not None
    assert color.degree == 3
    feeds = {"time": np.zeros(1, np.float32)}
    _, actual, _ = onnxruntime.InferenceSession(path).run(None, feeds)
    assert actual.shape == (4, 48)
    np.testing.assert_allclose(actual[:, :27], generator.sh.flatten(1), atol=1e-3)
    assert (actual[:, 27:] == 0).all()

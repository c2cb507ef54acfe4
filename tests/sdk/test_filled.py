"""Harmonics of degrees that a consumer does not take, as `gsgen export` writes them."""

from pathlib import Path
from typing import Literal

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor

from gsgen.contract.config import Settings
from gsgen.contract.finding import Level
from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs
from gsgen.sdk.filled import fill_harmonics


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


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize(
    ("dtype", "target", "written"),
    [
        ("float32", "core", (0, 1, 2, 3)),
        ("float16", "core", (1, 1, 3, 3)),
        ("float32", "visionary", (3, 3, 3, 3)),
    ],
)
def test_harmonics_are_filled_up_with_zeros_where_they_have_to_be(
    degree: int,
    dtype: Literal["float32", "float16"],
    target: str,
    written: tuple[int, ...],
    tmp_path: Path,
) -> None:
    generator, told = Glowing(degree), []
    fill_harmonics(generator, half=dtype == "float16", target=target, tell=told.append)
    path, settings = tmp_path / "glowing.onnx", Settings(level=Level.STATIC)
    made = export(generator, path, dtype=dtype, target=target, settings=settings)
    color = made.manifest.outputs.appearance
    assert color is not None
    assert color.degree == written[degree]
    feeds = {"time": np.zeros(1, np.float32)}
    _, seen, _ = onnxruntime.InferenceSession(path).run(None, feeds)
    kept = 3 * (degree + 1) ** 2
    assert seen.shape == (4, 3 * (written[degree] + 1) ** 2)
    np.testing.assert_allclose(seen[:, :kept], generator.sh.flatten(1), atol=1e-3)
    assert (seen[:, kept:] == 0).all()
    assert len(told) == (written[degree] != degree)

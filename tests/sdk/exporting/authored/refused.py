"""Modules that cannot be exported; the error names the guilty line and what to write instead."""

__all__ = ["REFUSED", "Refusal"]

from dataclasses import dataclass

import torch
from torch import Tensor

from gsgen.sdk import Gaussians, inputs
from sdk.exporting.authored.cloud import Cloud


class InverseMatrix(Cloud):
    """The inverse of a matrix, which ONNX has no operator for."""

    inputs = (inputs.view(),)

    def forward(self, view: Tensor) -> Gaussians:
        turn = torch.linalg.inv(view[:3, :3])  # guilty
        return self.cloud(position=self.rest @ turn.T)


class ShapeOfData(Cloud):
    """Boolean indexing, whose number of rows depends on the frame."""

    def forward(self, time: Tensor) -> Gaussians:
        rows = self.rest[:, 0] > 2 * time - 1
        position = self.rest[rows]  # guilty
        n = position.shape[0]
        return self.cloud().take(torch.arange(n))


class UnstableSum(Cloud):
    """A difference of huge numbers, in which float32 keeps no correct digit."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("factor", 1e5 * torch.randn(3, 1024))
        self.register_buffer("back", torch.randn(1024, 3))

    def forward(self, time: Tensor) -> Gaussians:
        product = (self.rest + time) @ self.factor
        return self.cloud(position=self.rest + torch.sin(product @ self.back))  # guilty


@dataclass(frozen=True, slots=True)
class Refusal:
    """A module that is not exported, and the hint of its error."""

    module: type[Cloud]
    hint: str  # a part of the hint
    has_line: bool = True  # whether a single line is guilty


REFUSED = (
    Refusal(InverseMatrix, "math.inverse_3x3"),
    Refusal(ShapeOfData, "gsgen.sdk.math.keep_rows"),
    Refusal(UnstableSum, "float64", has_line=False),
)

"""Generators that tracing cannot follow, one for each hazard; the guilty line says so."""

import numpy as np
import torch

from gsgen.sdk import Gaussians
from support.models.generators import Drift


class Branches(Drift):
    def forward(self, time: torch.Tensor) -> Gaussians:
        if (self.rest + time).max() > 0.5:  # guilty
            time = 2 * time
        return super().forward(time)


class BranchesOnItem(Drift):
    def forward(self, time: torch.Tensor) -> Gaussians:
        if time.item() > 0.5:  # guilty
            time = 2 * time
        return super().forward(time)


class GoesThroughNumpy(Drift):
    def forward(self, time: torch.Tensor) -> Gaussians:
        interpolated = np.interp(time.detach().cpu().numpy(), [0, 1], [0, 5])  # guilty
        return super().forward(torch.from_numpy(interpolated.astype(np.float32)))


class IndexesByMask(Drift):
    def forward(self, time: torch.Tensor) -> Gaussians:
        outputs = super().forward(time)
        keep_mask = outputs.position[:, 0] > time
        position = outputs.position[keep_mask]  # guilty
        n = position.shape[0]
        return Gaussians(
            position,
            outputs.opacity[:n],
            outputs.scale[:n],
            outputs.rotation[:n],
            sh=outputs.sh[:n],
        )


class UsesData(Drift):
    def forward(self, time: torch.Tensor) -> Gaussians:
        return super().forward(time.data)  # guilty


class Caches(Drift):
    """What it keeps from the first frame is right in torch and in the model, and wrong in both."""

    wave: torch.Tensor | None = None

    def forward(self, time: torch.Tensor) -> Gaussians:
        if self.wave is None:
            self.wave = torch.sin(time)  # guilty
        return super().forward(self.wave)


class Accumulates(Drift):
    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("clock", torch.zeros(1))

    def forward(self, time: torch.Tensor) -> Gaussians:
        self.clock += time  # guilty
        return super().forward(self.clock)


class DrawsNumbers(Drift):
    def forward(self, time: torch.Tensor) -> Gaussians:
        return super().forward(time + torch.rand(1))  # guilty


class ReadsAClock(Drift):
    """Random numbers of Python's own, which torch never sees."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        return super().forward(time + np.random.default_rng().random())


# ---- This exports, and the model is right: nothing may be said ---------------------------------


class RebuiltFromFloats(Drift):
    """What it keeps is the same in every frame, and torch follows the number."""

    grid: torch.Tensor | None = None

    def forward(self, time: torch.Tensor) -> Gaussians:
        if self.grid is None:
            self.grid = torch.linspace(0, 1, 50)[:, None]
        moment = torch.tensor([float(time)])  # guilty
        return super().forward(moment * self.grid)

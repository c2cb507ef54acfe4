"""Baking a sequence beside the least that it consists of: the model's runs, and writing the files.

Printed and asserted, by wall time; run by ``make bench``. CPU seconds are printed, too: beside other
load on the machine they say more.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.formats import Splats, open_splats, write_ply
from gsgen.runtime.baking import bake
from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs
from gsgen.sdk.binding import FrameSession
from support.measures import print_figure

COUNT, FRAMES, BAR = 100_000, 300, 1.5
MAX_MEMORY_GROWTH = 32e6  # bytes between the tenth and the last frame


class Moving(GaussianGenerator):
    """Gaussians of SH degree 3 whose centres move; covariances stay."""

    inputs = (inputs.time(),)

    def __init__(self) -> None:
        super().__init__()
        rng = np.random.default_rng(4)
        scale, rotation = rng.uniform(0.002, 0.02, (COUNT, 3)), rng.normal(size=(COUNT, 4))
        arrays = {
            "rest": rng.normal(size=(COUNT, 3)),
            "velocity": rng.normal(size=(COUNT, 3)),
            "rotation": rotation,
            "spin": rng.normal(size=(COUNT, 4)),
            "scale": scale,
            "covariance": covariance_upper(scale, rotation),
            "opacity": rng.uniform(0.2, 0.9, (COUNT, 1)),
            "sh": 0.2 * rng.normal(size=(COUNT, 16, 3)),
        }
        for name, array in arrays.items():
            self.register_buffer(name, torch.tensor(array, dtype=torch.float32))

    def forward(self, time: torch.Tensor) -> Gaussians:
        return Gaussians(
            position=self.rest + time * self.velocity,
            opacity=self.opacity,
            covariance=self.covariance,
            sh=self.sh,
        )


class Growing(Moving):
    """All covariances change in each frame."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        return Gaussians(
            position=self.rest + time * self.velocity,
            opacity=self.opacity,
            covariance=self.covariance * (1 + time),
            sh=self.sh,
        )


class Turning(Moving):
    """All rotations change in each frame; the model makes covariances of scales and rotations."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        return Gaussians(
            position=self.rest + time * self.velocity,
            opacity=self.opacity,
            scale=self.scale,
            rotation=self.rotation + time * self.spin,
            sh=self.sh,
        )


def _seconds(action: Callable[[], object]) -> np.ndarray:
    """Return the wall seconds and the CPU seconds of an action."""
    start_time = time.perf_counter(), time.process_time()
    action()
    return np.array([time.perf_counter(), time.process_time()]) - start_time


def _resident() -> int:
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])


@pytest.mark.parametrize("kind", [Moving, Growing, Turning])
def bench_bake(kind: type[GaussianGenerator], tmp_path: Path) -> None:
    model, file = tmp_path / "model.onnx", tmp_path / "frame.ply"
    export(kind(), model)
    times, resident = np.linspace(0, 1, FRAMES), []
    bake(model, file, time=0.5)
    splats = open_splats(file)
    assert isinstance(splats, Splats)

    def follow(text: str) -> None:
        """Delete files that are complete, which a disk need not keep up with."""
        if "writing" in text:
            resident.append(_resident())
            for path in sorted(tmp_path.glob("0*.ply"))[:-1]:  # the last may be in work
                path.unlink()

    def write() -> None:
        for number in range(FRAMES):
            write_ply(tmp_path / f"{number:04d}.ply", splats)
            (tmp_path / f"{number:04d}.ply").unlink()

    with FrameSession(model, provider="cpu") as session:
        session.run({"time": 0.5})
        inference = _seconds(lambda: [session.run({"time": moment}) for moment in times])
    writing = _seconds(write)
    baking = _seconds(lambda: bake(model, tmp_path / "%04d.ply", time=times, progress=follow))
    wall, cpu = baking / (inference + writing)
    growth = resident[-1] - resident[10]
    parts = ", ".join(
        f"{name} {1e3 * seconds[0] / FRAMES:.1f} ms ({1e3 * seconds[1] / FRAMES:.1f} CPU)"
        for name, seconds in (("bake", baking), ("inference", inference), ("writing", writing))
    )
    print_figure(f"{kind.__name__}, {COUNT:,} Gaussians, a frame: {parts}")
    print_figure(
        f"bake ÷ (inference + writing): {wall:.2f} by wall time (bar {BAR}), {cpu:.2f} by CPU time; "
        f"peak {max(resident) / 1e6:.0f} MB, {growth / 1e6:+.0f} MB from frame 10 to {FRAMES}"
    )
    sys.stdout.flush()
    assert growth <= MAX_MEMORY_GROWTH
    assert wall <= BAR

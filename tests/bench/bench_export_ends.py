"""CPU seconds that exports of large graphs take: python tests/bench/bench_export_ends.py [NAME …].

Bars: 32 levels of a hash grid 60 s, a formula of 12,000 operators 120 s, three StyleGAN2 U-Nets
60 s; the README's module at most 1.15 times what it took at commit 5c76bd09. Each export runs in a
process of its own, children included, at level behaviour for the target webgpu.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from gsgen.sdk import GaussianGenerator, Gaussians, inputs

_ROOT = Path(__file__).parents[2]
_BASE_COMMIT = "5c76bd09"
_MAX_RATIO = 1.15
_README_RUNS = 3
_POINTS = 300
_PRIMES = (1, 2654435761, 805459861, 3674653429)


class _Cloud(GaussianGenerator):
    """Points that a time moves."""

    inputs = (inputs.time(),)

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.xyz = nn.Parameter(torch.rand(_POINTS, 3) * 1.8 - 0.9)
        self.rotation = nn.Parameter(torch.randn(_POINTS, 4))
        self.color = nn.Parameter(torch.rand(_POINTS, 3))

    def cloud(self, position: Tensor, color: Tensor | None = None) -> Gaussians:
        """Return the points at other positions."""
        opacity, scale = torch.full((_POINTS,), 0.8), torch.full((_POINTS, 3), 0.05)
        rgb = self.color if color is None else color
        return Gaussians(position, opacity, scale, self.rotation, rgb=rgb)


class HashLevels(_Cloud):
    """An instant-NGP grid in plain torch (Müller et al. 2022, section 3): 64-bit hashes."""

    def __init__(self, levels: int = 32) -> None:
        super().__init__()
        self.tables = nn.Parameter(torch.randn(levels, 4096, 2))
        self.net = nn.Linear(2 * levels, 3)

    def forward(self, time: Tensor) -> Gaussians:
        """Move each point by the features around it."""
        x = (0.5 * self.xyz + 0.5 + 0.01 * time).clamp(0, 1)
        features = [_hashed(x, table, 10.0 + level) for level, table in enumerate(self.tables)]
        return self.cloud(self.xyz + 0.1 * self.net(torch.cat(features, 1)))


def _hashed(x: Tensor, table: Tensor, resolution: float) -> Tensor:
    """Interpolate a level's table at points [n, 3] of the unit cube, between eight corners."""
    scaled = x * resolution
    floor = torch.floor(scaled)
    fraction, corner = scaled - floor, floor.long()
    result = torch.zeros(len(x), table.shape[1])
    for number in range(8):
        weight: Tensor | float = 1.0
        key: Tensor | int = 0
        for axis in range(3):
            bit = number >> axis & 1
            weight = weight * (fraction[:, axis] if bit else 1 - fraction[:, axis])
            part = (corner[:, axis] + bit) * _PRIMES[axis]
            key = part if axis == 0 else key ^ part
        assert isinstance(weight, Tensor)
        result = result + weight[:, None] * table[(key & 0xFFFFFFFF) % len(table)]
    return result


class Formula(_Cloud):
    """A long formula: 4000 steps of three operators, none of which equals another."""

    def forward(self, time: Tensor) -> Gaussians:
        """Move each point by an iterated sine."""
        x = self.xyz + time
        for step in range(4000):
            x = torch.sin(x * (1 + 1e-4 * step) + 1e-3 * step)
        return self.cloud(self.xyz + 0.1 * x)


class _ModulatedConvolution(nn.Module):
    """Scale the weights by a style, and divide by their norm (Karras et al. 2020, section 2.2)."""

    def __init__(self, channels: int, filters: int, style: int, *, demodulate: bool = True) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.randn(filters, channels, 3, 3) / (9 * channels) ** 0.5)
        self.affine = nn.Linear(style, channels)
        self.bias = nn.Parameter(torch.zeros(filters))
        self.noise = nn.Parameter(torch.zeros(1))
        self.demodulate = demodulate

    def forward(self, x: Tensor, style: Tensor, noise: Tensor) -> Tensor:
        weight = self.weight[None] * (1 + self.affine(style))[:, None, :, None, None]
        if self.demodulate:
            weight = weight * torch.rsqrt(weight.square().sum(dim=[2, 3, 4], keepdim=True) + 1e-8)
        batch, channels, height, width = x.shape
        grouped = x.reshape(1, batch * channels, height, width)
        result = nn.functional.conv2d(grouped, weight.flatten(0, 1), padding=1, groups=batch)
        result = result.reshape(batch, -1, height, width) + self.noise * noise[:height, :width]
        return nn.functional.leaky_relu(result + self.bias[:, None, None], 0.2) * 2**0.5


class _UNet(nn.Module):
    """An encoder of residual blocks, and StyleGAN2's decoder with skips (Karras et al. 2020)."""

    def __init__(self, channels: int, filters: int, style: int = 32, size: int = 128) -> None:
        super().__init__()
        widths = [min(16 << level, 64) for level in range(6)]
        self.first = nn.Conv2d(channels, widths[0], 1)
        pairs = list(pairwise(widths))
        self.down = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1) for a, b in pairs)
        self.residual = nn.ModuleList(nn.Conv2d(a, b, 1, bias=False) for a, b in pairs)
        self.up = nn.ModuleList(_ModulatedConvolution(b + a, a, style) for a, b in reversed(pairs))
        self.refine = nn.ModuleList(_ModulatedConvolution(a, a, style) for a, _ in reversed(pairs))
        self.pictures = nn.ModuleList(
            _ModulatedConvolution(a, filters, style, demodulate=False) for a, _ in reversed(pairs)
        )
        kernel = torch.tensor([1.0, 3, 3, 1])
        self.register_buffer("kernel", torch.outer(kernel, kernel)[None, None] / 64)
        self.register_buffer("grid_noise", torch.randn(size, size))

    def blurred(self, x: Tensor) -> Tensor:
        """Halve the size after a low pass (Zhang 2019)."""
        channels = x.shape[1]
        kernel = self.kernel.expand(channels, 1, 4, 4)
        return nn.functional.conv2d(x, kernel, stride=2, padding=1, groups=channels)

    def forward(self, x: Tensor, style: Tensor) -> Tensor:
        x = nn.functional.leaky_relu(self.first(x), 0.2)
        skips = []
        for down, residual in zip(self.down, self.residual, strict=True):
            skips.append(x)
            deep = nn.functional.leaky_relu(down(self.blurred(x)), 0.2)
            x = (deep + residual(self.blurred(x))) / 2**0.5
        picture: Tensor | None = None
        for up, refine, to_picture in zip(self.up, self.refine, self.pictures, strict=True):
            enlarged = nn.functional.interpolate(x, scale_factor=2, mode="bilinear")
            x = up(torch.cat([enlarged, skips.pop()], 1), style, self.grid_noise)
            x = refine(x, style, self.grid_noise)
            part = to_picture(x, style, self.grid_noise)
            if picture is not None:
                part = part + nn.functional.interpolate(picture, scale_factor=2, mode="bilinear")
            picture = part
        assert picture is not None
        return picture


class ThreeUNets(_Cloud):
    """As AnimatableGaussians: networks of maps for positions, colours and other fields."""

    inputs = (inputs.pose(4),)

    def __init__(self) -> None:
        super().__init__()
        self.map = nn.Parameter(torch.randn(1, 3, 128, 128))
        self.style = nn.Linear(12, 32)
        self.nets = nn.ModuleList(_UNet(3, 3) for _ in range(3))
        self.register_buffer("rows", torch.randperm(128 * 128)[:_POINTS])

    def forward(self, pose: Tensor) -> Gaussians:
        """Decode the points' fields from maps of their texture."""
        style = self.style(pose.reshape(1, 12))
        maps = [net(self.map, style)[0].flatten(1).T[self.rows] for net in self.nets]
        moved = self.xyz + 0.05 * torch.tanh(maps[0]) * torch.sigmoid(maps[1])
        return self.cloud(moved, torch.sigmoid(maps[2]))


_CASES = {"HashLevels": 60.0, "Formula": 120.0, "ThreeUNets": 60.0}


def _export_seconds(target: str, folder: Path, *options: str, path: str = "") -> dict[str, float]:
    """Export a module in a process of its own; return its CPU seconds, in all and by stage."""
    environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    words = ("export", target, "-o", "m.onnx", "--json", *options)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    completed = subprocess.run(
        [sys.executable, "-m", "gsgen.cli", *words],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert completed.returncode == 0, completed.stdout[-2000:] + completed.stderr[-2000:]
    stages = json.loads(completed.stdout).get("stages", ())
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"all": seconds} | {stage["name"]: stage["cpu_seconds"] for stage in stages}


def _base_path(folder: Path) -> str:
    """Unpack the base commit's packages, and return a path that Python searches them on."""
    archive = subprocess.run(
        ["git", "archive", _BASE_COMMIT, "contract", "sdk", "runtime", "reference_plugins"],
        cwd=_ROOT, capture_output=True, check=True,
    )  # fmt: skip
    subprocess.run(["tar", "-x"], cwd=folder, input=archive.stdout, check=True)
    names = ("contract", "sdk", "runtime", "reference_plugins")
    return os.pathsep.join(str(folder / name) for name in names)


def _readme_module(folder: Path) -> None:
    text = (_ROOT / "README.md").read_text("utf-8").partition("<!-- test: drift.py -->")[2]
    (folder / "drift.py").write_text(text.partition("```python\n")[2].partition("```")[0], "utf-8")


def main(names: list[str]) -> int:
    """Print the CPU seconds of each export beside its bar; return 1 if a bar is missed."""
    is_good = True
    for name, bar in _CASES.items():
        if names and name not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            target = f"{Path(__file__).stem}:{name}"
            options = ("--target", "webgpu", "--timeout", "900")
            seconds = _export_seconds(
                target, Path(folder), *options, path=str(Path(__file__).parent)
            )
        is_good &= seconds["all"] <= bar
        stages = ", ".join(f"{stage} {value:.1f}" for stage, value in seconds.items())
        sys.stdout.write(f"{name}: {stages} CPU-s; bar {bar:g}\n")
        sys.stdout.flush()
    if not names or "README" in names:
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as base:
            _readme_module(Path(folder))
            paths = (_base_path(Path(base)), "")
            runs = [
                [_export_seconds("drift:Drift", Path(folder), path=path)["all"] for path in paths]
                for _ in range(_README_RUNS)
            ]
        before, now = (min(values) for values in zip(*runs, strict=True))
        is_good &= now <= _MAX_RATIO * before
        ratio = f"{now:.2f} of {before:.2f} CPU-s, {now / before:.2f} x"
        sys.stdout.write(f"README: {ratio}; bar {_MAX_RATIO}\n")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

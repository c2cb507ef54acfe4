"""The export of 4DGaussians beside a graph of the method as its authors write it.

Both come from one checkpoint and give the same Gaussians; the naive one samples all planes with
``grid_sample`` in every frame and goes through torch's exporter alone. Run by ``make bench``.
"""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from gsgen.contract.spec.layout import UPPER_TRIANGLE
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.deformation.hexplane_4dgs import HexPlane4DGS
from gsgen.reference_plugins.deformation.hexplane_checkpoint import (
    HexPlaneCheckpoint,
    read_hexplanes,
)
from gsgen.reference_plugins.synthetic import HexPlaneOptions, write_hexplane
from gsgen.sdk import export
from support.measures import print_figure, process_seconds

BAR, ROUNDS = 0.1, 7
_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))  # x, y, z, t


class NaiveHexPlane(nn.Module):
    """Wu et al. 2024 in the operators of the published code, with packed outputs."""

    def __init__(self, read: HexPlaneCheckpoint) -> None:
        super().__init__()
        self.canonical, self.nets = read.canonical, read.nets

    def forward(self, time: Tensor) -> tuple[Tensor, Tensor]:
        scene, nets = self.canonical, self.nets
        low, high = nets.aabb
        point = (scene.position - low) * (2.0 / (high - low)) - 1.0
        coordinates = torch.cat([point, time.reshape(1, 1).repeat(len(point), 1)], dim=1)
        levels = []
        for planes in nets.grids:
            features = torch.ones(())
            for plane, pair in zip(planes, _PAIRS, strict=True):
                sampled = torch.nn.functional.grid_sample(
                    plane[None], coordinates[None, None][..., list(pair)],
                    align_corners=True, padding_mode="border",
                )  # fmt: skip
                features = features * sampled[0, :, 0].transpose(0, 1)
            levels.append(features)
        hidden = torch.cat(levels, dim=-1)
        for index, (weight, bias) in enumerate(nets.feature):
            hidden = torch.relu(hidden) if index else hidden
            hidden = nn.functional.linear(hidden, weight, bias)
        change = {name: self._head(name, hidden) for name in nets.heads}
        scale = torch.exp(scene.log_scale + change["scales"])
        rotation = nn.functional.normalize(scene.rotation + change["rotations"])
        factor = _matrices(rotation) @ torch.diag_embed(scale)
        covariance = factor @ factor.transpose(1, 2)
        columns = [covariance[:, a, b] for a, b in UPPER_TRIANGLE]
        opacity = torch.sigmoid(scene.logit_opacity).reshape(-1, 1)
        position = scene.position + change["pos"]
        rows = torch.cat([position, opacity, torch.stack(columns, dim=1)], dim=1)
        return rows, scene.sh.flatten(1) * 1.0

    def _head(self, name: str, hidden: Tensor) -> Tensor:
        (weight, bias), last = self.nets.heads[name]
        inner = nn.functional.linear(torch.relu(hidden), weight, bias)
        return nn.functional.linear(torch.relu(inner), *last)


def _matrices(rotation: Tensor) -> Tensor:
    w, x, y, z = rotation.unbind(dim=1)
    entries = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(entries, dim=1).reshape(-1, 3, 3)


def _session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options)


def bench_hexplane_beside_the_naive_graph(tmp_path: Path) -> None:
    options = HexPlaneOptions(
        count=10_000, channels=32, resolution=(64, 64, 64, 100), multires=(1, 2), width=64
    )
    read = read_hexplanes(write_hexplane(tmp_path / "run", options))
    paths = [tmp_path / "naive.onnx", tmp_path / "gsgen.onnx"]
    time = torch.tensor([0.37])
    torch.onnx.export(
        NaiveHexPlane(read).eval(), (time,), paths[0], dynamo=True, input_names=["time"]
    )
    generator = HexPlane4DGS(read.canonical, read.nets, read.flags)
    export(generator, paths[1], settings=Settings(level=Level.STATIC))
    sessions = [_session(path) for path in paths]
    feeds = {"time": np.array([0.37], np.float32)}
    naive_seconds, ours = (session.run(None, feeds) for session in sessions)
    for expected, actual in zip(naive_seconds, ours, strict=False):  # the third output is the count
        np.testing.assert_allclose(actual.reshape(expected.shape), expected, atol=2e-4, rtol=2e-4)
    seconds = np.array(
        [
            [process_seconds(lambda run=session.run: run(None, feeds)) for session in sessions]
            for _ in range(ROUNDS)
        ]
    ).min(axis=0)
    ratio = seconds[1] / seconds[0]
    print_figure(
        f"a frame of 10,000: naive {1e3 * seconds[0]:.1f} ms, exported {1e3 * seconds[1]:.1f} ms; "
        f"ratio {ratio:.3f} (bar {BAR})"
    )
    counts = [len(onnx.load(path).graph.node) for path in paths]
    print_figure(f"nodes: naive {counts[0]}, exported {counts[1]}")
    assert ratio <= BAR

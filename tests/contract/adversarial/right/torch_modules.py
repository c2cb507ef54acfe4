"""Right models from ``torch.onnx.export``, without the project's SDK.

Torch takes seconds for each export, so a module is exported once and its weights are exchanged
for those of other scenes.
"""

import io
import warnings
from functools import cache, partial
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from contract.adversarial.case import Draft, right_model
from contract.adversarial.drafts import declare
from contract.adversarial.scenes import scene, sh_columns

TOOL = "torch.onnx.export"


class Still(torch.nn.Module):
    """Rows from parameters before their activations."""

    def __init__(self) -> None:
        super().__init__()
        for name, array in _weights("surface", "trained").items():
            self.register_parameter(name, torch.nn.Parameter(torch.from_numpy(array)))

    def packed(self, position: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Activate and pack."""
        w, x, y, z = torch.nn.functional.normalize(self.rotation, dim=1).unbind(1)
        columns = [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
        turn = torch.stack(columns, 1).reshape(-1, 3, 3)
        axes = turn * torch.exp(self.log_scale)[:, None, :]
        sigma = (axes @ axes.transpose(1, 2)).reshape(-1, 9)
        upper = torch.stack([sigma[:, column] for column in (0, 1, 2, 4, 5, 8)], 1)
        opacity = torch.sigmoid(self.logit)
        gaussians = torch.cat([position, opacity, upper], 1)
        return gaussians, self.harmonics * 1.0, torch.tensor([64], dtype=torch.int32)

    def forward(self) -> tuple[torch.Tensor, ...]:
        """One frame."""
        return self.packed(self.position * 1.0)


class Waving(Still):
    """The same, with positions that a small network moves."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.net = torch.nn.Sequential(
            torch.nn.Linear(4, 16), torch.nn.ReLU(), torch.nn.Linear(16, 3), torch.nn.Tanh()
        )

    def forward(self, time: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """One frame at a time."""
        angle = (6.2831855 * time).expand(64, 1)
        moved = self.net(torch.cat([self.position, torch.sin(angle)], 1))
        return self.packed(self.position + 0.1 * moved)


def _weights(kind: str, statistics: str) -> dict[str, np.ndarray]:
    source = scene(kind, statistics, seed=95)
    arrays = {
        "position": source.position,
        "logit": np.log(source.opacity / (1 - source.opacity))[:, None],
        "log_scale": np.log(source.scale),
        "rotation": 1.7 * source.rotation,
        "harmonics": sh_columns(source, 3),
    }
    return {name: array.astype(np.float32) for name, array in arrays.items()}


@cache
def _exported(module: type[Still]) -> bytes:
    inputs: tuple[Any, ...] = (torch.zeros(1),) if module is Waving else ()
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module().eval(),
            inputs,
            dynamo=True,
            opset_version=18,
            input_names=["time"] if inputs else [],
            output_names=["gaussians", "color", "num_points"],
            verbose=False,
            optimize=False,  # so that weights stay as they are named
        )
    assert program is not None
    onnx.save(program.model_proto, buffer)
    return buffer.getvalue()


def _filled(module: type[Still], kind: str, statistics: str) -> Draft:
    proto = onnx.ModelProto.FromString(_exported(module))
    weights = _weights(kind, statistics)
    replaced_count = 0
    for tensor in proto.graph.initializer:
        if tensor.name in weights:
            tensor.CopyFrom(numpy_helper.from_array(weights[tensor.name], tensor.name))
            replaced_count += 1
    if replaced_count != len(weights):
        raise ValueError(f"{replaced_count} of {len(weights)} weights were found in the graph")
    position = weights["position"]
    reach = 0.1 if module is Waving else 0.0
    inputs = [{"name": "time", "role": "time", "range": [0, 1], "default": 0, "loop": True}]
    low, high = position.min(0) - reach, position.max(0) + reach
    return Draft(proto, declare(64, low, high, inputs=inputs if module is Waving else []))


for module in (Still, Waving):
    for kind, statistics in (
        ("surface", "trained"),
        ("hair", "trained"),
        ("room", "trained"),
        ("cloud", "synthetic"),
        ("avatar", "trained"),
    ):
        right_model(
            f"torch_{module.__name__.lower()}_{kind}",
            TOOL,
            kind,
            statistics,
            build=partial(_filled, module, kind, statistics),
        )

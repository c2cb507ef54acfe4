"""Models that ``torch.onnx`` exports, through the SDK and without it; each is exported once.

An export takes a second, so each is then declared in several ways, and rewritten as tools do that
models pass through after their export.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import onnx
import torch
from onnx import ModelProto

from contract.rules.producers.good import UP, Good, declared, scene
from gsgen.contract.spec.manifest import (
    GeneratorManifest,
    ImageOutput,
    Input,
    PostProcessManifest,
    PostProcessOutputs,
    Space,
    Tolerances,
)
from gsgen.sdk import export
from support.models.generators import Bunches, Drift, Lit

_SDK = "torch.onnx, by gsgen.sdk"
_PLAIN = "torch.onnx"
_COUNT = 100
_ORDERS = ("column", "row")


class _Tinted(torch.nn.Module):
    """A network that has never heard of the SDK: time and camera change the colours."""

    def __init__(self) -> None:
        super().__init__()
        result = scene(_COUNT, None, seed=4)
        self.register_buffer("rows", torch.from_numpy(result.rows))
        torch.manual_seed(1)
        self.net = torch.nn.Sequential(
            torch.nn.Linear(4, 8), torch.nn.GELU(), torch.nn.Linear(8, 3)
        )

    def forward(
        self, camera: torch.Tensor, time: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        # Both memory orders are right: the camera's axes count, its place does not.
        size = torch.sqrt((camera[:3, :3] ** 2).sum().clamp(min=1e-6))
        toward = self.rows[:, :3] / size
        actual = torch.cat([toward, time.expand(_COUNT, 1)], dim=1)
        swing = torch.sin(time) * torch.eye(10)[0] * 0.1
        live = (time > -1.0).to(torch.int32) * _COUNT
        turned = 0.02 * torch.tanh(camera[2, :3].sum()) * torch.eye(10)[1]
        return self.rows + swing + turned, torch.sigmoid(self.net(actual)), live


class _Enhanced(torch.nn.Module):
    """A residual network of two convolutions."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(2)
        self.first = torch.nn.Conv2d(3, 8, 3, padding=1)
        self.second = torch.nn.Conv2d(8, 3, 3, padding=1)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        added = 0.1 * self.second(torch.relu(self.first(image)))
        return torch.clip(image + added, 0.0, 1.0)


def _traced(module: torch.nn.Module, example: tuple[Any, ...], **names: Any) -> bytes:
    program = torch.onnx.export(
        module.eval(), example, dynamo=True, opset_version=18, verbose=False, **names
    )
    assert program is not None
    return program.model_proto.SerializeToString()


@cache
def _tinted() -> bytes:
    return _traced(
        _Tinted(),
        (torch.eye(4), torch.zeros(1)),
        input_names=["camera", "time"],
        output_names=["gaussians", "color_rgb", "num_points"],
    )


@cache
def _enhanced() -> bytes:
    resizable = {2: torch.export.Dim.DYNAMIC, 3: torch.export.Dim.DYNAMIC}
    return _traced(
        _Enhanced(),
        (torch.rand(1, 3, 16, 24),),
        input_names=["image"],
        output_names=["out"],
        dynamic_shapes={"image": resizable},
    )


@cache
def _by_sdk(kind: str) -> tuple[bytes, GeneratorManifest]:
    result = {"drift": Drift, "lit": Lit, "bunches": Bunches}[kind]()
    dtype = "float16" if kind == "drift" else "float32"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.onnx"
        exported = export(result, path, dtype=dtype, capacity=255 if result.weighted_sum else 256)
        return path.read_bytes(), exported.manifest


def _exported_model(
    kind: str, change: Callable[[ModelProto], ModelProto], **expected_message: Any
) -> ModelProto:
    content, manifest = _by_sdk(kind)
    model = change(ModelProto.FromString(content))
    return declared(model, replace(manifest, **expected_message))


def _foreign(order: str, up: str, **expected_message: Any) -> ModelProto:
    result = scene(_COUNT, None, seed=4)
    manifest = result.manifest(
        Input(name="camera", role="view", default="identity"),
        Input(name="time", role="time", range=(0.0, 6.3), default=0.0),
        space=Space(up=up, matrix_order=order),
        room=1.3,
        **expected_message,
    )
    appearance = replace(manifest.outputs.appearance, name="color_rgb")
    outputs = replace(manifest.outputs, appearance=appearance)
    model = ModelProto.FromString(_tinted())
    return declared(model, replace(manifest, outputs=outputs))


def _sharpened() -> ModelProto:
    manifest = PostProcessManifest(
        name="enhance",
        inputs=(Input(name="image", role="image"),),
        outputs=PostProcessOutputs(ImageOutput("out")),
    )
    return declared(ModelProto.FromString(_enhanced()), manifest)


def _unchanged(model: ModelProto) -> ModelProto:
    return model


def _with_all_shapes(model: ModelProto) -> ModelProto:
    return onnx.shape_inference.infer_shapes(model, strict_mode=True, data_prop=True)


def _nameless(model: ModelProto) -> ModelProto:
    """Drop what debuggers read, as tools that shrink a file do."""
    for node in model.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
    del model.graph.value_info[:]
    del model.graph.metadata_props[:]
    return model


def _of_opset_20(model: ModelProto) -> ModelProto:
    return onnx.version_converter.convert_version(model, 20)


def models() -> Iterator[Good]:
    """Yield what two generators, a plain module and an image network become."""
    for kind, target in (("drift", "visionary"), ("lit", "webgpu")):
        for change in (_unchanged, _with_all_shapes, _nameless):
            name = f"{kind} {change.__name__.strip('_')}"
            yield Good(name, _SDK, partial(_exported_model, kind, change), target)
    yield Good(
        "cells of a weighted sum", _SDK, partial(_exported_model, "bunches", _unchanged), "webgpu"
    )
    yield Good("drift in opset 20", _SDK, partial(_exported_model, "drift", _of_opset_20))
    loose_case = partial(_exported_model, "drift", _unchanged, tolerances=Tolerances(position=0.01))
    yield Good("drift with its own tolerances", _SDK, loose_case)
    for index, up in enumerate(UP):
        order = _ORDERS[index % 2]
        draw = partial(_foreign, order, up)
        yield Good(f"tinted, up {up}, {order} matrices", _PLAIN, draw, "webgpu")
    yield Good("enhanced, any size", _PLAIN, _sharpened)

"""Right models that the project's own SDK exported, at its default options or in float16."""

import json
import tempfile
import warnings
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch

from contract.adversarial.case import Draft, right_model
from contract.adversarial.scenes import Scene, scene
from gsgen.contract.manifest import Space
from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs

TOOL = "gsgen.sdk"


class Static(GaussianGenerator):
    """A scene that does not change."""

    family = "static"
    space = Space(up="-y", unit="metre")

    def __init__(self, source: Scene, appearance: str) -> None:
        super().__init__()
        self.appearance = appearance
        for name in ("position", "opacity", "scale", "rotation", "sh", "rgb"):
            value = torch.from_numpy(getattr(source, name).astype(np.float32))
            self.register_buffer(name, value)

    def forward(self, *_: Any) -> Gaussians:
        """One frame."""
        appearance = {"rgb": self.rgb} if self.appearance == "rgb" else {"sh": self.sh[:, :4]}
        return Gaussians(self.position, self.opacity, self.scale, self.rotation, **appearance)


class Rising(Static):
    """A scene that rises with time."""

    family = "4d"
    inputs = (inputs.time(range=(0, 1)),)

    def forward(self, time: torch.Tensor, *_: Any) -> Gaussians:
        """One frame at a time."""
        opacity_offset = torch.tensor([0.0, -0.3, 0.0]) * time
        return Gaussians(
            self.position + opacity_offset, self.opacity, self.scale, self.rotation, sh=self.sh
        )


@cache
def _exported(module: type[Static], kind: str, appearance: str, dtype: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder) / "scene.onnx"
        export(module(scene(kind, seed=97), appearance), path, dtype=dtype)  # type: ignore[arg-type]
        return path.read_bytes()


def _read(module: type[Static], kind: str, appearance: str, dtype: str) -> Draft:
    proto = onnx.ModelProto.FromString(_exported(module, kind, appearance, dtype))
    entries = {entry.key: entry.value for entry in proto.metadata_props}
    manifest = json.loads(entries.pop("gsgen.manifest"))
    del proto.metadata_props[:]
    for key, value in entries.items():
        proto.metadata_props.add(key=key, value=value)
    return Draft(proto, manifest)


for module, kind, appearance, dtype in (
    (Static, "surface", "sh", "float32"),
    (Static, "hair", "rgb", "float32"),
    (Static, "room", "sh", "float16"),
    (Rising, "cloud", "sh", "float32"),
    (Rising, "avatar", "sh", "float16"),
):
    right_model(
        f"sdk_{module.__name__.lower()}_{kind}_{dtype}",
        TOOL,
        kind,
        "trained",
        build=partial(_read, module, kind, appearance, dtype),
    )

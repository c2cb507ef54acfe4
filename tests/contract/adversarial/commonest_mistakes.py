"""The commonest mistakes of authors of five families, as torch modules that people would write.

Each family is one module whose constructor takes the name of a mistake; without one it is right, so
each mistake is the line that differs, and the right line is what its finding's hint says.
"""

__all__ = ["MISTAKES", "Mistake", "write_model"]

import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch

from contract.adversarial.drafts import declare
from contract.adversarial.scenes import PIVOTS, scene
from gsgen.contract.model.model_file import MANIFEST_KEY

COUNT = 64


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake, the rule whose finding comes first, and words of its message or hint."""

    family: str
    name: str
    rule: str
    words: str


class Cloud(torch.nn.Module):
    """Parameters of Gaussians before their activations, as training stores them."""

    kind = "surface"

    def __init__(self, mistake: str = "") -> None:
        super().__init__()
        self.mistake = mistake
        source = scene(self.kind, "trained", seed=7, n=COUNT)
        arrays = {
            "position": source.position,
            "logit": np.log(source.opacity / (1 - source.opacity))[:, None],
            "log_scale": np.log(source.scale),
            "rotation": source.rotation,
            "rgb": 0.02 + 0.96 * (source.rgb - source.rgb.min()) / np.ptp(source.rgb),
        }
        for name, array in arrays.items():
            self.register_buffer(name, torch.from_numpy(array.astype(np.float32)))
        self.joint = torch.from_numpy(source.joint.astype(np.int64))

    def axes(self) -> torch.Tensor:
        """Return R S of each Gaussian, [N, 3, 3]."""
        w, x, y, z = torch.nn.functional.normalize(self.rotation, dim=1).unbind(1)
        columns = [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
        return torch.stack(columns, 1).reshape(-1, 3, 3) * torch.exp(self.log_scale)[:, None]

    def pack(
        self, position: torch.Tensor, opacity: torch.Tensor, axes: torch.Tensor
    ) -> torch.Tensor:
        """Return packed rows, [N, 10]."""
        sigma = (axes @ axes.transpose(1, 2)).reshape(-1, 9)
        upper = sigma[:, torch.tensor([0, 1, 2, 4, 5, 8])]
        return torch.cat([position, opacity, upper], 1)

    def count(self) -> torch.Tensor:
        """Return the row count."""
        return torch.tensor([COUNT], dtype=torch.int32)


class FeedForward(Cloud):
    """A network that computes Gaussians from a picture and the camera that sees it."""

    def __init__(self, mistake: str = "") -> None:
        super().__init__(mistake)
        torch.manual_seed(1)
        self.net = torch.nn.Conv2d(3, 8, 3, padding=1)
        self.head = torch.nn.Linear(8, 3)

    def forward(self, image: torch.Tensor, view: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """One picture."""
        features = self.net(image).mean((2, 3))
        shade = 0.1 * torch.tanh(self.head(features))
        matrix = view.t()  # column-major
        center = -matrix[:3, 3] @ matrix[:3, :3]
        position, opacity = self.position + 0.2 * shade, torch.sigmoid(self.logit)
        distance = (position - center).norm(dim=1, keepdim=True)
        if self.mistake == "centres relative to the camera":
            position = position - center
        if self.mistake == "logits in place of opacities":
            opacity = self.logit
        opacity = opacity * torch.exp(-0.02 * distance)
        rgb = (0.98 * self.rgb + 0.01 + 0.1 * shade * self.rgb).clamp(0, 1)
        if self.mistake == "colours of a tanh":
            rgb = 2 * rgb - 1
        rows = self.pack(position, opacity, self.axes())
        if self.mistake == "the batch axis":
            rows = rows[None]
        count = self.count()
        if self.mistake == "a count of int64":
            count = torch.tensor([COUNT])
        return rows, rgb, count


class Avatar(Cloud):
    """A person whose limbs follow the joints of a pose."""

    kind = "avatar"

    def forward(self, pose: torch.Tensor, trans: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """One pose."""
        if self.mistake == "degrees":
            pose = pose * (torch.pi / 180)
        squared = (pose * pose).sum(1, keepdim=True)
        floor = 0.0 if self.mistake == "the norm of zero" else 1e-12
        angle = (squared + floor).sqrt()
        x, y, z = (pose / angle).unbind(1)
        zero = torch.zeros_like(x)
        cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
        sine, cosine = torch.sin(angle)[:, :, None], torch.cos(angle)[:, :, None]
        turns = torch.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)
        turn = turns[self.joint]
        pivot = torch.from_numpy(PIVOTS.astype(np.float32))[self.joint]
        position = (turn @ (self.position - pivot)[:, :, None])[:, :, 0] + pivot
        shift = trans / 100 if self.mistake == "centimetres" else trans
        axes = self.axes() if self.mistake == "covariances at rest" else turn @ self.axes()
        rgb = self.rgb + 0 * trans[0]
        if self.mistake == "colours of bytes":
            rgb = torch.round(255 * rgb)
        return self.pack(position + shift, torch.sigmoid(self.logit), axes), rgb, self.count()


class Dynamic(Cloud):
    """A scene in motion."""

    def forward(self, time: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """One moment."""
        moment = time
        if self.mistake == "a time of the trace":
            moment = torch.tensor([float(time)])
        if self.mistake == "frames that never come":
            moment = torch.floor(time * 11) / 12
        turn = 6.2831855 * moment
        shift = torch.cat([torch.sin(turn), torch.cos(turn) - 1, 0 * turn])
        if self.mistake == "a loop that does not close":
            shift = torch.cat([moment, 0 * moment, 0 * moment])
        if self.mistake == "bounds of the first moment":
            shift = 8 * shift
        position = self.position + 0.2 * shift * (1 + self.position[:, :1])
        if self.mistake == "noise of the training":
            position = position + 0.01 * torch.randn_like(position)
        return (
            self.pack(position, torch.sigmoid(self.logit), self.axes()),
            self.rgb + 0 * moment,
            self.count(),
        )


class Detail(Cloud):
    """Gaussians that fade or are left out by their distance from the camera."""

    def forward(self, view: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """One camera."""
        matrix = view if self.mistake == "the other memory order" else view.t()
        turn, shift = matrix[:3, :3], matrix[:3, 3]
        center = -shift if self.mistake == "a centre without the rotation" else -shift @ turn
        depth = self.position @ turn[2] + shift[2]
        distance = (self.position - center).norm(dim=1)
        opacity = torch.sigmoid(self.logit) * torch.exp(-0.05 * distance)[:, None]
        is_seen = depth > 0.01
        if self.mistake == "OpenGL's forward":
            is_seen = depth < -0.01
        opacity = torch.where(is_seen[:, None], opacity, torch.zeros_like(opacity))
        rows = self.pack(self.position, opacity, self.axes())
        direction = (self.position - center) / distance.clamp_min(1e-6)[:, None]
        sheen = 0.5 + 0.5 * direction @ torch.tensor([0.6, -0.64, 0.48])
        count, rgb = self.count(), self.rgb * (0.6 + 0.4 * sheen[:, None])
        if self.mistake == "rows chosen by a mask":
            rows, rgb = rows[distance < 9], rgb[distance < 9]
        if self.mistake == "a count without sorting":
            count = torch.tensor([COUNT // 2], dtype=torch.int32)
        return rows, rgb, count


class Restorer(torch.nn.Module):
    """A network that restores a drawn picture."""

    def __init__(self, mistake: str = "") -> None:
        super().__init__()
        self.mistake = mistake
        torch.manual_seed(2)
        self.net = torch.nn.Conv2d(3, 3, 3, padding=1)
        with torch.no_grad():
            self.net.weight *= 0.05
            self.net.bias.zero_()
        self.drop = torch.nn.Dropout(0.2)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """One picture."""
        height, width = image.shape[2:]
        if self.mistake == "cropped to a multiple of eight":
            image = image[:, :, : height // 8 * 8, : width // 8 * 8]
        x = image
        if self.mistake == "the logarithm of black":
            x = torch.exp(torch.log(x)) + 0 * torch.log(x)
        if self.mistake == "a dropout of the training":
            x = torch.nn.functional.dropout(x, 0.2, training=True)
        result = (x + self.net(x)).clamp(0, 1)
        if self.mistake == "bytes":
            result = 255 * result
        if self.mistake == "channels last":
            result = result.permute(0, 2, 3, 1)
        return result


# Family → module, example inputs, and the manifest's entries of inputs.
_TIME: dict[str, Any] = {
    "name": "time",
    "role": "time",
    "range": [0, 1],
    "default": 0,
    "loop": True,
}
_VIEW = {"name": "view", "role": "view", "default": "identity"}
_IMAGE = {"name": "image", "role": "image", "range": [0, 1]}
_POSE = {"name": "pose", "role": "pose", "range": [-0.7, 0.7], "default": "zeros"}
_TRANS = {"name": "trans", "role": "root_translation", "range": [-0.3, 0.3], "default": "zeros"}
FAMILIES: dict[
    str, tuple[type[torch.nn.Module], tuple[torch.Tensor, ...], list[dict[str, Any]]]
] = {
    "feed-forward": (
        FeedForward,
        (torch.rand(1, 3, 8, 8), torch.eye(4)),
        [_IMAGE | {"default": "zeros"}, _VIEW],
    ),
    "avatar": (Avatar, (torch.full((4, 3), 0.1), torch.zeros(3)), [_POSE, _TRANS]),
    "4D": (Dynamic, (torch.zeros(1),), [_TIME]),
    "level of detail": (Detail, (torch.eye(4),), [_VIEW]),
    "post-process": (Restorer, (torch.rand(1, 3, 32, 48),), [_IMAGE]),
}
MISTAKES = (
    Mistake("feed-forward", "centres relative to the camera", "GV059", "Add the camera's centre"),
    Mistake("feed-forward", "logits in place of opacities", "GV003", "Apply the sigmoid"),
    Mistake("feed-forward", "colours of a tanh", "GV012", "(x + 1) / 2"),
    Mistake("feed-forward", "the batch axis", "GO003", "Drop the batch axis"),
    Mistake("feed-forward", "a count of int64", "GO011", "Cast the count to int32"),
    Mistake("avatar", "covariances at rest", "GB068", "R Σ Rᵀ"),
    Mistake("avatar", "the norm of zero", "GI009", "Guard the division or the norm"),
    Mistake("avatar", "centimetres", "GB041", "in the unit of the positions"),
    Mistake("avatar", "degrees", "GI018", "Divide degrees by 180"),
    Mistake("avatar", "colours of bytes", "GV012", "Divide by 255"),
    Mistake("4D", "a time of the trace", "GM004", "export without detaching it"),
    Mistake("4D", "frames that never come", "GB069", "floor(time · frames + 0.001)"),
    Mistake("4D", "a loop that does not close", "GB004", "loop"),
    Mistake("4D", "noise of the training", "GG010", "Draw the numbers before export"),
    Mistake("4D", "bounds of the first moment", "GV021", "Measure bounds over all times"),
    Mistake("level of detail", "OpenGL's forward", "GV054", "along +z"),
    Mistake("level of detail", "a centre without the rotation", "GB030", "inverse rotation"),
    Mistake("level of detail", "the other memory order", "GI007", "matrix_order"),
    Mistake("level of detail", "rows chosen by a mask", "GO004", "fixed capacity"),
    Mistake("level of detail", "a count without sorting", "GV018", "Move the live rows to the front"),
    Mistake("post-process", "bytes", "GV057", "scale the image at its end"),
    Mistake("post-process", "the logarithm of black", "GB043", "logarithm or norm that sees a black pixel"),
    Mistake("post-process", "cropped to a multiple of eight", "GV056", "Pad the image to the multiple"),
    Mistake("post-process", "channels last", "GV056", "permute(0, 3, 1, 2)"),
    Mistake("post-process", "a dropout of the training", "GG025", "model.eval()"),
)  # fmt: skip


def write_model(path: Path, family: str, mistake: str = "") -> None:
    """Export a family's module with a mistake by ``torch.onnx.export``, and embed its manifest."""
    module_type, inputs, entries = FAMILIES[family]
    module = module_type(mistake).eval()
    is_image = family == "post-process"
    names = ["result"] if is_image else ["gaussians", "color", "num_points"]
    options: dict[str, Any] = {}
    if is_image:
        options["dynamic_axes"] = {"image": {2: "height", 3: "width"}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the older exporter, and of what a trace fixes
        torch.onnx.export(
            module,
            inputs,
            str(path),
            dynamo=False,
            opset_version=18,
            input_names=[entry["name"] for entry in entries],
            output_names=names,
            **options,
        )
    manifest = _image_manifest() if is_image else _manifest(family, mistake, entries)
    model = onnx.load(path)
    model.metadata_props.add(key=MANIFEST_KEY, value=json.dumps(manifest))
    onnx.save(model, path)


def _manifest(family: str, mistake: str, entries: list[dict[str, Any]]) -> dict[str, Any]:
    position = scene(FAMILIES[family][0].kind, "trained", seed=7, n=COUNT).position  # type: ignore[attr-defined]
    reach = {"feed-forward": 0.1, "avatar": 1.2, "4D": 1.0, "level of detail": 0.05}[family]
    inputs = [dict(entry) for entry in entries]
    if mistake == "degrees":
        inputs[0]["range"] = [-40, 40]
    if mistake == "frames that never come":
        inputs[0] |= {"frames": 12, "loop": False}
    return declare(
        COUNT, position.min(0) - reach, position.max(0) + reach, space="rgb", inputs=inputs
    )


def _image_manifest() -> dict[str, Any]:
    return {
        "contract": "1.0",
        "kind": "post-process",
        "name": "restorer",
        "version": "1.0.0",
        "producer": {"tool": "exporter 1.0", "license": "CC0-1.0"},
        "inputs": [_IMAGE],
        "outputs": {"image": {"name": "result", "range": [0, 1], "color_space": "srgb"}},
    }

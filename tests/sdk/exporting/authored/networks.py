"""Networks: encodings, attention, recurrence, embeddings, and what wraps them."""

__all__ = ["MODULES"]

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the name that every method uses

from gsgen.sdk import Gaussians, inputs
from sdk.exporting.authored.cloud import Cloud, N


class FrequencyEncoded(Cloud):
    """Deformable 3DGS: sines of positions and time, and a network with a skip."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("bands", 2.0 ** torch.arange(4))
        self.first, self.second = nn.Linear(4 * 9, 32), nn.Linear(32 + 4 * 9, 10)

    def forward(self, time: Tensor) -> Gaussians:
        x = torch.cat([self.rest, time.expand(N, 1)], dim=-1)
        angles = (x[..., None] * self.bands).flatten(1)
        encoded = torch.cat([x, angles.sin(), angles.cos()], dim=-1)
        hidden = F.relu(self.first(encoded))
        d_xyz, d_rotation, d_scale = self.second(torch.cat([encoded, hidden], -1)).split(
            [3, 4, 3], dim=-1
        )
        return self.cloud(
            position=self.rest + 0.1 * d_xyz,
            rotation=self.rotation + 0.1 * d_rotation,
            scale=self.scale * torch.exp(0.1 * d_scale),
        )


class LowPrecision(Cloud):
    """A network under bfloat16 autocast, as trained."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(4, 32), nn.SiLU(), nn.Linear(32, 3))

    def forward(self, time: Tensor) -> Gaussians:
        x = torch.cat([self.rest, time.expand(N, 1)], dim=-1)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            color = self.net(x)
        return self.cloud(rgb=torch.sigmoid(color.float()))


class HalfPrecision(Cloud):
    """A network whose weights are stored and multiplied as float16."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(4, 32), nn.ReLU(), nn.Linear(32, 3)).half()

    def forward(self, time: Tensor) -> Gaussians:
        x = torch.cat([self.rest, time.expand(N, 1)], dim=-1)
        return self.cloud(rgb=torch.sigmoid(self.net(x.half())).float())


class TokenTransformer(Cloud):
    """LHM: a transformer encoder over tokens of points."""

    def __init__(self) -> None:
        super().__init__()
        layer = nn.TransformerEncoderLayer(
            16, 4, dim_feedforward=32, batch_first=True, norm_first=True
        )
        self.embed, self.encoder = nn.Linear(3, 16), nn.TransformerEncoder(layer, 2)
        self.head = nn.Linear(16, 3)

    def forward(self, time: Tensor) -> Gaussians:
        tokens = self.embed(self.rest + time)[None]
        return self.cloud(position=self.rest + 0.1 * self.head(self.encoder(tokens))[0])


class CrossAttention(Cloud):
    """Points attend to learned tokens by ``scaled_dot_product_attention``."""

    def __init__(self) -> None:
        super().__init__()
        self.tokens = nn.Parameter(torch.randn(8, 16))
        self.query, self.key, self.value = nn.Linear(3, 16), nn.Linear(16, 16), nn.Linear(16, 16)
        self.norm, self.head = nn.LayerNorm(16), nn.Linear(16, 3)

    def forward(self, time: Tensor) -> Gaussians:
        def heads(x: Tensor) -> Tensor:
            return x.view(1, -1, 2, 8).transpose(1, 2)

        query = heads(self.query(self.rest + time))
        context = F.scaled_dot_product_attention(
            query, heads(self.key(self.tokens)), heads(self.value(self.tokens))
        )
        hidden = self.norm(context.transpose(1, 2).reshape(N, 16))
        return self.cloud(rgb=torch.sigmoid(self.head(F.gelu(hidden))))


class LayeredRecurrence(Cloud):
    """An LSTM over a window of sound energies."""

    inputs = (inputs.control("energy", range=(0, 1), default=0.5, size=6),)

    def __init__(self) -> None:
        super().__init__()
        self.lstm, self.head = nn.LSTM(1, 8, batch_first=True), nn.Linear(8, 3)

    def forward(self, energy: Tensor) -> Gaussians:
        states, _ = self.lstm(energy.view(1, 6, 1))
        return self.cloud(position=self.rest + self.head(states[:, -1]))


class AnchorsDecoded(Cloud):
    """Scaffold-GS: neural Gaussians of anchors, coloured by the direction of view."""

    inputs = (inputs.camera_position(),)

    def __init__(self) -> None:
        super().__init__()
        self.anchor, self.features = (
            nn.Parameter(torch.randn(12, 3)),
            nn.Parameter(torch.randn(12, 8)),
        )
        self.offsets = nn.Parameter(0.2 * torch.randn(12, 4, 3))
        self.color = nn.Sequential(nn.Linear(12, 16), nn.ReLU(True), nn.Linear(16, 12))

    def forward(self, camera: Tensor) -> Gaussians:
        ray = self.anchor - camera
        distance = ray.norm(dim=1, keepdim=True)
        view = torch.cat([self.features, ray / distance, distance], dim=1)
        color = torch.sigmoid(self.color(view)).reshape([N, 3])
        position = self.anchor.repeat_interleave(4, dim=0) + self.offsets.view(-1, 3)
        return self.cloud(position=position, rgb=color)


class Compiled(Cloud):
    """A network behind ``torch.compile``."""

    def __init__(self) -> None:
        super().__init__()
        net = nn.Sequential(nn.Linear(4, 16), nn.Softplus(beta=10), nn.Linear(16, 3))
        self.net = torch.compile(net, backend="eager")

    def forward(self, time: Tensor) -> Gaussians:
        x = torch.cat([self.rest, time.expand(N, 1)], dim=-1)
        return self.cloud(position=self.rest + 0.1 * self.net(x))


class _TruncatedExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return torch.exp(x)

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Any:
        (x,) = ctx.saved_tensors
        return gradients[0] * torch.exp(x.clamp(-15, 15))


class CustomGradient(Cloud):
    """Instant-NGP's truncated exponential: an autograd function of its own."""

    def forward(self, time: Tensor) -> Gaussians:
        scale: Tensor = _TruncatedExp.apply(torch.log(self.scale) + 0.5 * torch.sin(time))
        return self.cloud(scale=scale)


class Vectorised(Cloud):
    """A function of one Gaussian, mapped over all by ``torch.vmap``."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Linear(4, 3)

    def forward(self, time: Tensor) -> Gaussians:
        def moved(point: Tensor) -> Tensor:
            return point + 0.1 * torch.tanh(self.net(torch.cat([point, time])))

        return self.cloud(position=torch.vmap(moved)(self.rest))


MODULES = (
    FrequencyEncoded,
    LowPrecision,
    HalfPrecision,
    TokenTransformer,
    CrossAttention,
    LayeredRecurrence,
    AnchorsDecoded,
    Compiled,
    CustomGradient,
    Vectorised,
)

"""A U-Net in float64 that walks a checkpoint's names and options, not the plugin's modules."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812

Weights = Mapping[str, torch.Tensor]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Blocks:
    """The blocks of a U-Net for one timestep and one prompt."""

    cfg: Mapping[str, Any]
    w: Weights
    time: torch.Tensor
    context: torch.Tensor | None
    groups: int
    eps: float
    conditional: bool

    def residual(self, name: str, x: torch.Tensor, shrink: float = 1.0) -> torch.Tensor:
        h = conv(
            self.w, f"{name}.conv1", F.silu(norm(self.w, f"{name}.norm1", x, self.groups, self.eps))
        )
        moment = linear(self.w, f"{name}.time_emb_proj", self.time)[0, :, None, None]
        if self.cfg.get("resnet_time_scale_shift") == "scale_shift":
            scale, shift = moment.split(len(moment) // 2)
            h = norm(self.w, f"{name}.norm2", h, self.groups, self.eps) * (1 + scale) + shift
        else:
            h = norm(self.w, f"{name}.norm2", h + moment, self.groups, self.eps)
        h = conv(self.w, f"{name}.conv2", F.silu(h))
        if f"{name}.conv_shortcut.weight" in self.w:
            x = conv(self.w, f"{name}.conv_shortcut", x)
        return (x + h) / shrink

    def attend(self, name: str, x: torch.Tensor, shrink: float = 1.0) -> torch.Tensor:
        c, n = x.shape[1], x.shape[2] * x.shape[3]
        if self.conditional:
            return self.transform(name, x)
        width = self.cfg.get("attention_head_dim", 8)
        heads = 1 if width is None else c // width
        tokens = norm(self.w, f"{name}.group_norm", x, self.groups, self.eps).reshape(c, n).T
        attended = attention(self.w, name, tokens, tokens, heads)
        return (x + attended.T.reshape(x.shape)) / shrink

    def transform(self, name: str, x: torch.Tensor) -> torch.Tensor:
        assert self.context is not None
        c, n = x.shape[1], x.shape[2] * x.shape[3]
        heads = self.cfg["attention_head_dim"]
        weight = self.w[f"{name}.proj_in.weight"].reshape(c, c)
        tokens = norm(self.w, f"{name}.norm", x, self.groups, 1e-6).reshape(c, n).T
        tokens = tokens @ weight.T + self.w[f"{name}.proj_in.bias"]
        for depth in range(self.cfg.get("transformer_layers_per_block", 1)):
            b = f"{name}.transformer_blocks.{depth}"
            normalised = layer_norm(self.w, f"{b}.norm1", tokens)
            tokens = tokens + attention(self.w, f"{b}.attn1", normalised, normalised, heads)
            two = layer_norm(self.w, f"{b}.norm2", tokens)
            tokens = tokens + attention(self.w, f"{b}.attn2", two, self.context[0].double(), heads)
            three = linear(self.w, f"{b}.ff.net.0.proj", layer_norm(self.w, f"{b}.norm3", tokens))
            value, gate = three.split(three.shape[1] // 2, dim=1)
            bell = 0.5 * gate * (1 + torch.erf(gate / math.sqrt(2)))
            tokens = tokens + linear(self.w, f"{b}.ff.net.2", value * bell)
        weight = self.w[f"{name}.proj_out.weight"].reshape(c, c)
        tokens = tokens @ weight.T + self.w[f"{name}.proj_out.bias"]
        return x + tokens.T.reshape(x.shape)


def unet(
    cfg: Mapping[str, Any],
    w: Weights,
    x: torch.Tensor,
    t: float,
    context: torch.Tensor | None = None,
    pooled: torch.Tensor | None = None,
    numbers: Sequence[float] = (),
) -> torch.Tensor:
    """What UNet2DModel or UNet2DConditionModel gives.

    Args:
        cfg: Its configuration.
        w: Its weights.
        x: The image.
        t: The timestep.
        context: A vector for each token of the prompt, [1, L, D].
        pooled: One for all of it, [1, P], of networks that are told of the image.
        numbers: What they are told of it.
    """
    w = {name: value.double() for name, value in w.items()}
    groups, eps = cfg["norm_num_groups"], cfg.get("norm_eps", 1e-5)
    time = waves(cfg, t, cfg["block_out_channels"][0])
    time = linear(w, "time_embedding.linear_1", time)
    time = linear(w, "time_embedding.linear_2", F.silu(time))
    if pooled is not None:
        conditions = [waves(cfg, n, cfg["addition_time_embed_dim"]) for n in numbers]
        vector = torch.cat([pooled.double(), *conditions], dim=1)
        vector = F.silu(linear(w, "add_embedding.linear_1", vector))
        time = time + linear(w, "add_embedding.linear_2", vector)
    time = F.silu(time)

    blocks = _Blocks(
        cfg=cfg,
        w=w,
        time=time,
        context=context,
        groups=groups,
        eps=eps,
        conditional=cfg["_class_name"] == "UNet2DConditionModel",
    )
    residual, attend = blocks.residual, blocks.attend
    x = conv(w, "conv_in", x.double())
    skips = [x]
    levels = len(cfg["block_out_channels"])
    for level in range(levels):
        for layer in range(cfg["layers_per_block"]):
            x = residual(f"down_blocks.{level}.resnets.{layer}", x)
            if "Attn" in cfg["down_block_types"][level]:
                x = attend(f"down_blocks.{level}.attentions.{layer}", x)
            skips.append(x)
        if level < levels - 1:
            name = f"down_blocks.{level}.downsamplers.0.conv"
            x = F.conv2d(x, w[f"{name}.weight"], w[f"{name}.bias"], stride=2, padding=1)
            skips.append(x)
    shrink = cfg.get("mid_block_scale_factor", 1.0)
    x = residual("mid_block.resnets.0", x, shrink)
    x = attend("mid_block.attentions.0", x, shrink)
    x = residual("mid_block.resnets.1", x, shrink)
    for level in range(levels):
        for layer in range(cfg["layers_per_block"] + 1):
            joined = torch.cat([x, skips.pop()], dim=1)
            x = residual(f"up_blocks.{level}.resnets.{layer}", joined)
            if "Attn" in cfg["up_block_types"][level]:
                x = attend(f"up_blocks.{level}.attentions.{layer}", x)
        if level < levels - 1:
            x = x.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
            x = conv(w, f"up_blocks.{level}.upsamplers.0.conv", x)
    return conv(w, "conv_out", F.silu(norm(w, "conv_norm_out", x, groups, eps)))


def waves(cfg: Mapping[str, Any], value: float, width: int) -> torch.Tensor:
    """Sines and cosines of one number."""
    half = width // 2
    rates = [
        math.exp(-math.log(10000) * i / (half - cfg.get("freq_shift", 0))) for i in range(half)
    ]
    sines = [math.sin(value * r) for r in rates]
    cosines = [math.cos(value * r) for r in rates]
    flip = cfg.get("flip_sin_to_cos", True)
    return torch.tensor([cosines + sines if flip else sines + cosines], dtype=torch.float64)


def linear(w: Weights, name: str, x: torch.Tensor) -> torch.Tensor:
    """X Wᵀ + b."""
    return x @ w[f"{name}.weight"].T + w[f"{name}.bias"]


def conv(w: Weights, name: str, x: torch.Tensor) -> torch.Tensor:
    """A convolution that keeps the size."""
    weight = w[f"{name}.weight"]
    return F.conv2d(x, weight, w[f"{name}.bias"], padding=weight.shape[-1] // 2)


def norm(w: Weights, name: str, x: torch.Tensor, groups: int, eps: float) -> torch.Tensor:
    """Group norm, by its definition."""
    parts = x.reshape(groups, -1)
    mean, spread = parts.mean(1, keepdim=True), parts.var(1, keepdim=True, correction=0)
    normalised = ((parts - mean) / torch.sqrt(spread + eps)).reshape(x.shape)
    return normalised * w[f"{name}.weight"][:, None, None] + w[f"{name}.bias"][:, None, None]


def layer_norm(w: Weights, name: str, x: torch.Tensor) -> torch.Tensor:
    """Layer norm, by its definition."""
    mean, spread = x.mean(1, keepdim=True), x.var(1, keepdim=True, correction=0)
    return (x - mean) / torch.sqrt(spread + 1e-5) * w[f"{name}.weight"] + w[f"{name}.bias"]


def attention(
    w: Weights, name: str, tokens: torch.Tensor, source: torch.Tensor, heads: int
) -> torch.Tensor:
    """One head after the other."""
    q, k, v = (
        x @ w[f"{name}.to_{p}.weight"].T + w.get(f"{name}.to_{p}.bias", torch.zeros(()))
        for p, x in (("q", tokens), ("k", source), ("v", source))
    )
    size = q.shape[1] // heads
    head_outputs = []
    for head in range(heads):
        columns = slice(head * size, (head + 1) * size)
        head_outputs.append(
            torch.softmax(q[:, columns] @ k[:, columns].T / math.sqrt(size), dim=1) @ v[:, columns]
        )
    return linear(w, f"{name}.to_out.0", torch.cat(head_outputs, dim=1))

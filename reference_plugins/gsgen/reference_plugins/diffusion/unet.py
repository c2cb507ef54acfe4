"""U-Nets that predict noise (UNet2DModel and UNet2DConditionModel of diffusers)."""

__all__ = ["UNet", "added_vector", "time_features"]

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.diffusion.blocks import (
    Downsample,
    ImageAttention,
    Residual,
    Transformer,
    Upsample,
)
from gsgen.reference_plugins.diffusion.options import UNetOptions

_SLOWEST = 10000.0


def time_features(
    moment: Float[Tensor, " b"], width: int, *, flip: bool, shift: float
) -> Float[Tensor, "b width"]:
    """Return sines and cosines of a diffusion timestep (Vaswani et al. 2017, section 3.5).

    ``flip`` puts cosines first; ``shift`` is subtracted from the number of frequencies.
    """
    half = width // 2
    exponent = -math.log(_SLOWEST) * torch.arange(half, dtype=torch.float32) / (half - shift)
    angle = moment[:, None].float() * torch.exp(exponent)[None]
    parts = [torch.sin(angle), torch.cos(angle)]
    return torch.cat(parts[::-1] if flip else parts, dim=1)


def added_vector(
    pooled: Float[Tensor, "1 p"], time_ids: Sequence[float], options: UNetOptions
) -> Float[Tensor, "1 v"]:
    """Return the vector of prompt and image sizes that SDXL adds to the embedded timestep.

    It joins the pooled prompt and the features of each size (Podell et al. 2023, section 2.2).

    ``time_ids`` are original height and width, top and left of the crop, target height and width.
    """
    vector = options.vector
    assert vector is not None
    features = time_features(
        torch.tensor(time_ids), vector.features, flip=options.flip, shift=options.shift
    )
    joined = torch.cat([pooled.float(), features.reshape(1, -1)], dim=1)
    if joined.shape[1] != vector.length:
        lengths = f"{pooled.shape[1]} + {len(time_ids)} × {vector.features}"
        raise ValueError(
            f"the prompt vector and time ids have {lengths} = {joined.shape[1]} numbers, "
            f"expected {vector.length}"
        )
    return joined


class _Level(nn.Module):
    """Residual blocks of one U-Net resolution, with optional attention after each."""

    def __init__(
        self, options: UNetOptions, index: int, kind: str, sizes: list[tuple[int, int]]
    ) -> None:
        super().__init__()
        outputs = options.channels[index]
        self.kind = kind
        self.resnets = nn.ModuleList(_residual(options, i, o) for i, o in sizes)
        if kind:
            self.attentions = nn.ModuleList(
                _attention_block(options, kind, outputs, index) for _ in sizes
            )

    def apply_block(
        self, index: int, image: Tensor, time: Tensor, context: Tensor | None
    ) -> Tensor:
        features: Tensor = self.resnets[index](image, time)
        return (
            _apply_attention(self.attentions[index], features, context) if self.kind else features
        )


class _Down(_Level):
    def __init__(self, options: UNetOptions, index: int) -> None:
        outputs = options.channels[index]
        before = options.channels[max(index - 1, 0)]
        sizes = [(before if i == 0 else outputs, outputs) for i in range(options.layers)]
        super().__init__(options, index, options.down[index], sizes)
        last = index == len(options.channels) - 1
        self.downsamplers = None if last else nn.ModuleList([Downsample(outputs, options.padding)])

    def forward(
        self, image: Tensor, time: Tensor, context: Tensor | None
    ) -> tuple[Tensor, list[Tensor]]:
        skips = []
        for index in range(len(self.resnets)):
            image = self.apply_block(index, image, time, context)
            skips.append(image)
        if self.downsamplers is not None:
            image = self.downsamplers[0](image)
            skips.append(image)
        return image, skips


class _Up(_Level):
    def __init__(self, options: UNetOptions, step: int) -> None:
        levels = options.channels[::-1]
        outputs, before = levels[step], levels[max(step - 1, 0)]
        skipped = levels[min(step + 1, len(levels) - 1)]
        count = options.layers + 1
        sizes = [
            ((before if i == 0 else outputs) + (skipped if i == count - 1 else outputs), outputs)
            for i in range(count)
        ]
        super().__init__(options, len(levels) - 1 - step, options.up[step], sizes)
        last = step == len(levels) - 1
        self.upsamplers = None if last else nn.ModuleList([Upsample(outputs)])

    def forward(
        self, image: Tensor, skips: list[Tensor], time: Tensor, context: Tensor | None
    ) -> Tensor:
        for index in range(len(self.resnets)):
            joined = torch.cat([image, skips.pop()], dim=1)
            image = self.apply_block(index, joined, time, context)
        return image if self.upsamplers is None else self.upsamplers[0](image)


class _Middle(nn.Module):
    def __init__(self, options: UNetOptions, kind: str) -> None:
        super().__init__()
        width, index = options.channels[-1], len(options.channels) - 1
        self.resnets = nn.ModuleList(
            _residual(options, width, width, options.shrink) for _ in range(2)
        )
        self.attends = kind == "context" or options.attends
        if self.attends:
            self.attentions = nn.ModuleList(
                [_attention_block(options, kind, width, index, options.shrink)]
            )

    def forward(self, image: Tensor, time: Tensor, context: Tensor | None) -> Tensor:
        image = self.resnets[0](image, time)
        if self.attends:
            image = _apply_attention(self.attentions[0], image, context)
        output: Tensor = self.resnets[1](image, time)
        return output


def _residual(options: UNetOptions, i: int, o: int, shrink: float = 1.0) -> Residual:
    return Residual(
        i,
        o,
        groups=options.groups,
        eps=options.eps,
        time=options.time,
        shifts=options.shifts,
        shrink=shrink,
    )


def _attention_block(
    options: UNetOptions, kind: str, channels: int, index: int, shrink: float = 1.0
) -> nn.Module:
    heads = options.heads[index]
    if kind == "image":
        width = channels // heads
        return ImageAttention(
            channels, heads, width, groups=options.groups, eps=options.eps, shrink=shrink
        )
    assert options.context is not None
    return Transformer(
        channels,
        heads,
        groups=options.groups,
        context=options.context,
        depth=options.depth[index],
        linear=options.linear,
    )


def _apply_attention(block: nn.Module, image: Tensor, context: Tensor | None) -> Tensor:
    attended: Tensor = block(image, context) if isinstance(block, Transformer) else block(image)
    return attended


class _Embedding(nn.Module):
    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.linear_1 = nn.Linear(inputs, width)
        self.linear_2 = nn.Linear(width, width)

    def forward(self, features: Tensor) -> Tensor:
        embedded: Tensor = self.linear_2(F.silu(self.linear_1(features)))
        return embedded


class UNet(nn.Module):
    """A U-Net: levels down, a middle block, and levels up with skip connections."""

    def __init__(self, options: UNetOptions) -> None:
        super().__init__()
        self.options = options
        first, last = options.kernels
        steps = range(len(options.channels))
        self.conv_in = nn.Conv2d(
            options.inputs, options.channels[0], first, padding=(first - 1) // 2
        )
        self.time_embedding = _Embedding(options.channels[0], options.time)
        self.add_embedding = (
            None if options.vector is None else _Embedding(options.vector.length, options.time)
        )
        self.down_blocks = nn.ModuleList(_Down(options, index) for index in steps)
        self.mid_block = None if options.middle is None else _Middle(options, options.middle)
        self.up_blocks = nn.ModuleList(_Up(options, step) for step in steps)
        self.conv_norm_out = nn.GroupNorm(options.groups, options.channels[0], eps=options.eps)
        self.conv_out = nn.Conv2d(
            options.channels[0], options.outputs, last, padding=(last - 1) // 2
        )

    def forward(
        self,
        image: Float[Tensor, "b i h w"],
        moment: Float[Tensor, " b"],
        context: Float[Tensor, "b m d"] | None = None,
        vector: Float[Tensor, "b v"] | None = None,
    ) -> Float[Tensor, "b o h w"]:
        """Return the prediction of the U-Net, such as noise.

        The sides of ``image`` are multiples of the options' stride; :func:`added_vector` gives
        ``vector``.
        """
        options = self.options
        features = time_features(
            moment, options.channels[0], flip=options.flip, shift=options.shift
        )
        time = self.time_embedding(features.to(image.dtype))
        if self.add_embedding is not None:
            time = time + self.add_embedding(vector)
        image = self.conv_in(2 * image - 1 if options.centre else image)
        skips = [image]
        for down in self.down_blocks:
            image, level_skips = down(image, time, context)
            skips += level_skips
        if self.mid_block is not None:
            image = self.mid_block(image, time, context)
        for up in self.up_blocks:
            image = up(image, skips, time, context)
        predicted: Tensor = self.conv_out(F.silu(self.conv_norm_out(image)))
        return predicted

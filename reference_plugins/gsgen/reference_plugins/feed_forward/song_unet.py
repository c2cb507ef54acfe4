"""The U-Net of Splatter Image: DDPM++ without a noise level, after Song et al. 2021.

Its parameters have the names and shapes of the training code, which took the network from EDM. A
block normalises, convolves, normalises and convolves again, and adds its input; each sum is divided
by √2. Attention of a block is over the pixels of one picture, or of all pictures of an object.
"""

__all__ = ["SongUNet", "SongUNetOptions"]

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

_SKIP_SCALE = math.sqrt(0.5)
_CHANNELS_PER_GROUP, _MAX_GROUPS = 4, 32
_NORM_EPSILON = 1e-6
# Channels of each level, as a multiple of the width; each level has half the resolution.
LEVEL_WIDTHS = (1, 2, 2, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class SongUNetOptions:
    """Sizes of a Splatter Image U-Net.

    Attributes:
        resolution: Pixels of a side on the first level, by which blocks are named.
        width: Channels of the first level.
        inputs: Channels of the input.
        outputs: Channels of the output.
        blocks: Residual blocks of each level down; there is one more on the way up.
        attention: Resolutions whose blocks have attention.
        embedding: Numbers that describe a picture's camera; 0 for none.
        pictures: Number of pictures that attention joins.
    """

    resolution: int
    width: int
    inputs: int
    outputs: int
    blocks: int
    attention: tuple[int, ...]
    embedding: int = 0
    pictures: int = 1


class SongUNet(nn.Module):
    """A U-Net of four levels: pictures [v, inputs, h, w] become features [v, outputs, h, w]."""

    def __init__(self, options: SongUNetOptions) -> None:
        super().__init__()
        self.options = options
        emb_channels = 4 * options.width if options.embedding else 0
        if options.embedding:
            self.map_layer0 = nn.Linear(options.embedding, emb_channels)
            self.map_layer1 = nn.Linear(emb_channels, emb_channels)

        def block(
            inputs: int, outputs: int, resample: str = "", *, attention: bool = False
        ) -> _Block:
            return _Block(inputs, outputs, emb_channels, resample, attention, options.pictures)

        # Down: the first convolution, or a block that halves the sides; then the level's blocks.
        self.enc, skip_widths, channels = nn.ModuleDict(), [], options.width
        for level, factor in enumerate(LEVEL_WIDTHS):
            side = options.resolution >> level
            if level == 0:
                self.enc[f"{side}x{side}_conv"] = _convolution(options.inputs, channels, 3)
            else:
                self.enc[f"{side}x{side}_down"] = block(channels, channels, "down")
            skip_widths.append(channels)
            for number in range(options.blocks):
                outputs = options.width * factor
                attention = side in options.attention
                self.enc[f"{side}x{side}_block{number}"] = block(
                    channels, outputs, attention=attention
                )
                channels = outputs
                skip_widths.append(channels)
        # Up: two blocks at the bottom, or one that doubles the sides; then blocks with skips.
        self.dec = nn.ModuleDict()
        for level, factor in reversed(list(enumerate(LEVEL_WIDTHS))):
            side = options.resolution >> level
            if level == len(LEVEL_WIDTHS) - 1:
                self.dec[f"{side}x{side}_in0"] = block(channels, channels, attention=True)
                self.dec[f"{side}x{side}_in1"] = block(channels, channels)
            else:
                self.dec[f"{side}x{side}_up"] = block(channels, channels, "up")
            for number in range(options.blocks + 1):
                outputs = options.width * factor
                attention = number == options.blocks and side in options.attention
                self.dec[f"{side}x{side}_block{number}"] = block(
                    channels + skip_widths.pop(), outputs, attention=attention
                )
                channels = outputs
        side = options.resolution
        self.dec[f"{side}x{side}_aux_norm"] = _group_norm(channels)
        self.dec[f"{side}x{side}_aux_conv"] = _convolution(channels, options.outputs, 3)

    def forward(
        self, pictures: Float[Tensor, "v i h w"], camera: Float[Tensor, "v e"] | None = None
    ) -> Float[Tensor, "v o h w"]:
        """Return the features of each pixel; ``camera`` describes the camera of each picture."""
        embedding = None
        if camera is not None:
            embedding = functional.silu(self.map_layer0(camera))
            embedding = functional.silu(self.map_layer1(embedding))
        x, skips = pictures, []
        for layer in self.enc.values():
            x = layer(x, embedding) if isinstance(layer, _Block) else layer(x)
            skips.append(x)
        for name, layer in self.dec.items():
            if isinstance(layer, _Block):
                if "_block" in name:
                    x = torch.cat([x, skips.pop()], dim=1)
                x = layer(x, embedding)
            else:
                x = layer(functional.silu(x)) if name.endswith("aux_conv") else layer(x)
        return x


class _Block(nn.Module):
    """A residual block that may halve or double the sides first, and attend last."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        embedding: int,
        resample: str,
        attention: bool,  # noqa: FBT001
        pictures: int,
    ) -> None:
        super().__init__()
        self.resample, self.pictures = resample, pictures
        if embedding:
            self.affine = nn.Linear(embedding, outputs)
        self.norm0, self.conv0 = _group_norm(inputs), _convolution(inputs, outputs, 3)
        self.norm1, self.conv1 = _group_norm(outputs), _convolution(outputs, outputs, 3)
        has_projection = inputs != outputs or bool(resample)
        self.skip = _convolution(inputs, outputs, 1) if has_projection else nn.Identity()
        self.has_attention = attention
        if attention:
            self.norm2 = _group_norm(outputs)
            self.qkv = _convolution(outputs, 3 * outputs, 1)
            self.proj = _convolution(outputs, outputs, 1)

    def forward(self, x: Float[Tensor, "v i h w"], embedding: Tensor | None) -> Tensor:
        """Return the features of the next layer."""
        residual = self.skip(self._resampled(x))
        x = self.conv0(self._resampled(functional.silu(self.norm0(x))))
        if embedding is not None:
            x = functional.silu(self.norm1(x + self.affine(embedding)[:, :, None, None]))
        x = self.conv1(functional.silu(self.norm1(x)))  # normalised twice with an embedding
        x = (x + residual) * _SKIP_SCALE
        return (self._attended(x) + x) * _SKIP_SCALE if self.has_attention else x

    def _resampled(self, x: Tensor) -> Tensor:
        if self.resample == "down":
            return functional.avg_pool2d(x, 2)
        if self.resample == "up":
            return functional.interpolate(x, scale_factor=2.0, mode="nearest")
        return x

    def _attended(self, x: Float[Tensor, "v c h w"]) -> Float[Tensor, "v c h w"]:
        """Return the attention of all pixels of an object's pictures to each other."""
        count, channels, height, width = x.shape
        objects = count // self.pictures
        # Step 1: the pictures of an object become one picture, below each other. The norm sees it.
        stacked = x.reshape(objects, self.pictures, channels, height * width).transpose(1, 2)
        stacked = stacked.reshape(objects, channels, self.pictures * height, width)
        # Step 2: of each three channels of the projection, one is a query, one a key, one a value.
        projected = self.qkv(self.norm2(stacked)).reshape(objects, channels, 3, -1)
        query, key, value = projected.unbind(2)
        scores = query.transpose(1, 2) @ (key / math.sqrt(channels))
        attended = value @ torch.softmax(scores, dim=2).transpose(1, 2)
        # Step 3: back to pictures.
        tall = attended.reshape(objects, channels, self.pictures * height, width)
        result: Tensor = self.proj(tall).reshape(objects, channels, self.pictures, height * width)
        return result.transpose(1, 2).reshape(count, channels, height, width)


def _convolution(inputs: int, outputs: int, side: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, side, padding=side // 2)


def _group_norm(channels: int) -> nn.GroupNorm:
    groups = min(_MAX_GROUPS, channels // _CHANNELS_PER_GROUP)
    return nn.GroupNorm(groups, channels, eps=_NORM_EPSILON)

"""Reads checkpoints of LGM: one file of weights, from which the sizes of the network follow.

The layout is that of 3DTopia/LGM, ``main.py`` and ``infer.py``: ``model.safetensors``, or a state
dict that ``torch.save`` wrote.
"""

__all__ = ["LgmCheckpoint", "read_lgm"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from gsgen.reference_plugins.feed_forward.multi_view_unet import (
    GROUPS,
    MultiViewUNet,
    MultiViewUNetOptions,
)
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.safetensors import is_safetensors, read_safetensors
from gsgen.reference_plugins.loading.states import entries_below, load_state, require_tensors

CHANNELS = 14
"""Numbers of a Gaussian: position, opacity, scale, rotation, colour."""
_INPUT_CHANNELS = 9  # colours, and the six Plücker coordinates of the pixel's ray
_FILE_NAMES = ("model.safetensors", "model_fp16_fixrot.safetensors", "model_fp16.safetensors")


@dataclass(frozen=True, slots=True, kw_only=True)
class LgmCheckpoint:
    """The network of an LGM checkpoint, and its last layer."""

    weights: Path
    unet: MultiViewUNet
    head: tuple[Float[Tensor, "o o 1 1"], Float[Tensor, " o"]]  # the last 1×1 convolution

    def describe(self) -> str:
        """Return the sizes of the network as one line."""
        options = self.unet.options
        count = sum(weight.numel() for weight in self.unet.parameters())
        return (
            f"{self.weights}: U-Net with {len(options.down)} levels down and {len(options.up)} up, "
            f"{count:,} weights"
        )


def read_lgm(path: Path) -> LgmCheckpoint:
    """Read an LGM checkpoint: a file, or a folder with one."""
    file = path
    if path.is_dir():
        candidates = [path / name for name in _FILE_NAMES if (path / name).is_file()]
        file = candidates[0] if candidates else path / _FILE_NAMES[0]
    required_file(file, "the weights of the network")
    state = read_safetensors(file) if is_safetensors(file) else load_state(file, "the weights")
    network = entries_below(state, "unet.")
    unet = MultiViewUNet(_options_of(network, file))
    expected = {name: tuple(value.shape) for name, value in unet.state_dict().items()}
    unet.load_state_dict(require_tensors(file, network, expected), strict=True)
    shapes = {"conv.weight": (CHANNELS, CHANNELS, 1, 1), "conv.bias": (CHANNELS,)}
    head = require_tensors(file, state, shapes, ignored=("unet.", "lpips_loss."))
    return LgmCheckpoint(
        weights=file, unet=unet.eval(), head=(head["conv.weight"], head["conv.bias"])
    )


def _options_of(network: Mapping[str, Any], file: Path) -> MultiViewUNetOptions:
    """Return the sizes of a network by its tensors."""
    down, down_attention = _levels(network, "down_blocks")
    up, up_attention = _levels(network, "up_blocks")
    if not down or not up or len(up) > len(down):
        message = f"has {len(down)} levels down and {len(up)} up, expected those of LGM"
        hint = "Give the file that LGM's README names, such as model_fp16_fixrot.safetensors."
        raise CheckpointInvalid(message, where=str(file), hint=hint)
    if any(width % GROUPS for width in (*down, *up)):
        message = f"has levels of {down} and {up} channels, expected multiples of {GROUPS}"
        raise CheckpointInvalid(message, where=str(file))
    return MultiViewUNetOptions(
        inputs=_INPUT_CHANNELS,
        outputs=CHANNELS,
        down=down,
        down_attention=down_attention,
        middle_attention="mid_block.attns.0.norm.weight" in network,
        up=up,
        up_attention=up_attention,
    )


def _levels(network: Mapping[str, Any], name: str) -> tuple[tuple[int, ...], tuple[bool, ...]]:
    """Return the width of each level, and whether it has attention."""
    widths: list[int] = []
    attention: list[bool] = []
    while isinstance(weight := network.get(f"{name}.{len(widths)}.nets.0.conv1.weight"), Tensor):
        attention.append(f"{name}.{len(widths)}.attns.0.norm.weight" in network)
        widths.append(weight.shape[0])
    return tuple(widths), tuple(attention)

"""Reads networks that restore or enlarge images; keys and shapes of a file tell which one it is.

The layouts are those of xinntao/Real-ESRGAN and XPixelGroup/BasicSR (``RRDBNet``,
``SRVGGNetCompact``), JingyunLiang/SwinIR (``SwinIR``) and megvii-research/NAFNet (``NAFNet``): a
state dict, or a dict with one below ``params_ema`` or ``params``.
"""

__all__ = ["read_network"]

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from gsgen.reference_plugins.enhancers.compact_net import CompactNet, CompactOptions
from gsgen.reference_plugins.enhancers.enhancer import ImageNetwork
from gsgen.reference_plugins.enhancers.naf_net import NAFNet, NAFNetOptions
from gsgen.reference_plugins.enhancers.rrdb_net import RRDBNet, RRDBOptions
from gsgen.reference_plugins.enhancers.swin_ir import SwinIR, SwinIROptions, Upsampler
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.safetensors import is_safetensors, read_safetensors
from gsgen.reference_plugins.loading.states import load_state, require_tensors

# Where training code keeps the state dict; averaged weights are those that results are made with.
_WRAPPERS = ("params_ema", "params", "state_dict", "model")
_RRDB_CHANNELS = {3: 4, 12: 2, 48: 1}  # channels of the first layer → scale
# Buffers that follow from the sizes.
_IGNORED = re.compile(r"\.(relative_position_index|attn_mask)$")

State = Mapping[str, Any]


def read_network(file: Path) -> ImageNetwork:
    """Read a network that restores or enlarges images, of any of the known layouts.

    Raises:
        CheckpointInvalid: The file is of another layout, or a tensor is missing or does not fit.
    """
    required_file(file, "the weights of the network")
    state: State = (
        read_safetensors(file) if is_safetensors(file) else load_state(file, "the weights")
    )
    for name in _WRAPPERS:
        if isinstance(state.get(name), dict):
            state = state[name]
    # Tools that clean weights up wrap them once more.
    state = {name.removeprefix("module."): value for name, value in state.items()}
    state = {name: value for name, value in state.items() if not _IGNORED.search(name)}
    for key, read in _LAYOUTS.items():
        if key in state:
            network = read(_Shapes(file, state))
            expected = {name: tuple(value.shape) for name, value in network.state_dict().items()}
            network.load_state_dict(require_tensors(file, state, expected), strict=True)
            return network
    message = "is not a network of a known layout"
    hint = (
        "Known are Real-ESRGAN (RRDBNet and SRVGGNetCompact), SwinIR and NAFNet, as their own "
        "training code saves them."
    )
    raise CheckpointInvalid(message, where=str(file), hint=hint)


class _Shapes:
    """The shapes of a state dict's tensors, and the counts in its names."""

    def __init__(self, file: Path, state: State) -> None:
        self.file, self.state = file, state

    def __call__(self, name: str, axes: int) -> tuple[int, ...]:
        """Return the shape of a tensor with so many axes; raise if it is missing or has others."""
        value = self.state.get(name)
        if not isinstance(value, Tensor) or value.ndim != axes:
            actual = list(value.shape) if isinstance(value, Tensor) else "missing"
            raise self.fault(f"{name} is {actual}, expected a tensor with {axes} axes")
        return tuple(value.shape)

    def count(self, pattern: str) -> int:
        """Return how many numbers 0, 1, … stand for the group of a pattern at the names' start."""
        numbers = {int(match[1]) for name in self.state if (match := re.match(pattern, name))}
        return next(n for n in range(len(numbers) + 1) if n not in numbers)

    def fault(self, message: str, hint: str = "") -> CheckpointInvalid:
        return CheckpointInvalid(message, where=str(self.file), hint=hint)

    def require_colors(self, name: str, channels: int) -> None:
        """Raise if a network works on another number of channels than three."""
        if channels != 3:
            raise self.fault(f"{name} takes {channels} channels, expected 3: red, green and blue")

    def scale_of(self, name: str, channels: int) -> int:
        """Return the scale of a layer that gives the pixels of each enlarged one as channels."""
        scale = math.isqrt(channels // 3)
        if 3 * scale**2 != channels or not scale:
            raise self.fault(f"{name} gives {channels} channels, expected three times a square")
        return scale


def _read_rrdb(shapes: _Shapes) -> ImageNetwork:
    width, channels, *_ = shapes("conv_first.weight", 4)
    if channels not in _RRDB_CHANNELS:
        known = ", ".join(map(str, _RRDB_CHANNELS))
        raise shapes.fault(f"conv_first.weight takes {channels} channels, expected one of {known}")
    growth = shapes("body.0.rdb1.conv1.weight", 4)[0]
    blocks = shapes.count(r"body\.(\d+)\.")
    options = RRDBOptions(scale=_RRDB_CHANNELS[channels], width=width, growth=growth, blocks=blocks)
    return RRDBNet(options)


def _read_compact(shapes: _Shapes) -> ImageNetwork:
    width, channels, *_ = shapes("body.0.weight", 4)
    shapes.require_colors("body.0.weight", channels)
    if "body.1.weight" not in shapes.state:
        message = "body.1.weight is missing: rectifiers without weights are relu or leakyrelu"
        raise shapes.fault(message, hint="Known are networks with the activation prelu.")
    entries = shapes.count(r"body\.(\d+)\.")
    name = f"body.{entries - 1}.weight"
    scale = shapes.scale_of(name, shapes(name, 4)[0])
    return CompactNet(CompactOptions(scale=scale, width=width, layers=(entries - 3) // 2))


def _read_naf_net(shapes: _Shapes) -> ImageNetwork:
    width, channels, *_ = shapes("intro.weight", 4)
    shapes.require_colors("intro.weight", channels)

    def counts(name: str) -> tuple[int, ...]:
        levels = shapes.count(rf"{name}\.(\d+)\.")
        return tuple(shapes.count(rf"{name}\.{level}\.(\d+)\.") for level in range(levels))

    options = NAFNetOptions(
        width=width,
        encoder=counts("encoders"),
        middle=shapes.count(r"middle_blks\.(\d+)\."),
        decoder=counts("decoders"),
    )
    if len(options.encoder) != len(options.decoder):
        levels = f"{len(options.encoder)} levels down and {len(options.decoder)} up"
        raise shapes.fault(f"has {levels}, expected as many")
    return NAFNet(options)


def _read_swin_ir(shapes: _Shapes) -> ImageNetwork:
    block = "layers.0.residual_group.blocks.0"
    width, channels, *_ = shapes("conv_first.weight", 4)
    shapes.require_colors("conv_first.weight", channels)
    if "absolute_pos_embed" in shapes.state:
        raise shapes.fault("has absolute_pos_embed, which fixes the size of images")
    offsets, heads = shapes(f"{block}.attn.relative_position_bias_table", 2)
    window = (math.isqrt(offsets) + 1) // 2
    if (2 * window - 1) ** 2 != offsets or width % heads:
        message = f"{heads} heads of {width} channels with {offsets} relative positions"
        raise shapes.fault(f"has {message}, expected the square of an odd number")
    layers = shapes.count(r"layers\.(\d+)\.")
    upsampler, scale, after = _upsampling(shapes)
    return SwinIR(
        SwinIROptions(
            scale=scale,
            width=width,
            depths=tuple(
                shapes.count(rf"layers\.{layer}\.residual_group\.blocks\.(\d+)\.")
                for layer in range(layers)
            ),
            heads=heads,
            window=window,
            hidden=shapes(f"{block}.mlp.fc1.weight", 2)[0],
            upsampler=upsampler,
            width_after=after,
            three_convolutions="layers.0.conv.0.weight" in shapes.state,
            has_bias=f"{block}.attn.qkv.bias" in shapes.state,
            has_first_norm="patch_embed.norm.weight" in shapes.state,
        )
    )


def _upsampling(shapes: _Shapes) -> tuple[Upsampler, int, int]:
    """Return how a SwinIR enlarges, by how much, and with how many channels."""
    if "conv_before_upsample.0.weight" in shapes.state:
        after = shapes("conv_before_upsample.0.weight", 4)[0]
        if "conv_up1.weight" in shapes.state:
            return "nearest", 4 if "conv_up2.weight" in shapes.state else 2, after
        steps = [
            math.isqrt(shapes(f"upsample.{index}.weight", 4)[0] // after)
            for index in range(0, 8, 2)
            if f"upsample.{index}.weight" in shapes.state
        ]
        return "shuffle", math.prod(steps), after
    if "upsample.0.weight" in shapes.state:
        channels = shapes("upsample.0.weight", 4)[0]
        return "shuffle-once", shapes.scale_of("upsample.0.weight", channels), 0
    return "none", 1, 0


# A tensor that only files of the layout have → its reader.
_LAYOUTS: Mapping[str, Callable[[_Shapes], ImageNetwork]] = {
    "body.0.rdb1.conv1.weight": _read_rrdb,
    "layers.0.residual_group.blocks.0.attn.qkv.weight": _read_swin_ir,
    "intro.weight": _read_naf_net,
    "body.0.weight": _read_compact,
}

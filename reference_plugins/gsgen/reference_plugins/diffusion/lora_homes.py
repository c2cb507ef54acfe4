"""Where the tensors of a LoRA belong: the names that tools give to layers of these networks.

diffusers and peft keep a layer's name, below the network's. sd-scripts ("kohya") joins it by
underscores. Tools that descend from the original code of latent diffusion know the same layers as
``input_blocks.4.1…``, in a count of their own.
"""

__all__ = ["homes_of"]

import re
from collections.abc import Iterator

from torch import nn

from gsgen.reference_plugins.diffusion.unet import UNet

_KOHYA = "lora_unet_"
# Parts of a residual block, as the original code numbers them.
_PARTS = {
    "conv1": "in_layers.2",
    "time_emb_proj": "emb_layers.1",
    "conv2": "out_layers.3",
    "conv_shortcut": "skip_connection",
}
_OUTSIDE = {
    "conv_in": "input_blocks.0.0",
    "conv_out": "out.2",
    "time_embedding.linear_1": "time_embed.0",
    "time_embedding.linear_2": "time_embed.2",
    "add_embedding.linear_1": "label_emb.0.0",
    "add_embedding.linear_2": "label_emb.0.2",
}
_LAYER = re.compile(
    r"(?P<way>down_blocks|mid_block|up_blocks)(?:\.(?P<level>\d+))?"
    r"\.(?P<kind>resnets|attentions|downsamplers|upsamplers)\.(?P<place>\d+)\.(?P<rest>.+)"
)


def homes_of(unet: UNet, autoencoder: nn.Module | None) -> dict[str, nn.Module]:
    """Return the layers with a matrix or a kernel of both networks, by every name they go by."""
    found: dict[str, nn.Module] = {}
    for name, layer in _layers(unet):
        for known in (name, _original(name, unet)):
            found |= {known: layer, f"unet.{known}": layer}
            found |= {f"diffusion_model.{known}": layer}
            found[_KOHYA + known.replace(".", "_")] = layer
    for name, layer in () if autoencoder is None else _layers(autoencoder):
        found |= {name: layer, f"vae.{name}": layer}
    return found


def _layers(network: nn.Module) -> Iterator[tuple[str, nn.Module]]:
    for name, layer in network.named_modules():
        if isinstance(layer, nn.Linear | nn.Conv2d):
            yield name, layer


def _original(name: str, unet: UNet) -> str:
    """Return what the original code of latent diffusion calls a layer of a U-Net."""
    found = _LAYER.fullmatch(name)
    if found is None:
        return _OUTSIDE.get(name, name)
    kind, rest, place = found["kind"], found["rest"], int(found["place"])
    if kind == "resnets":
        rest = _PARTS.get(rest, rest)
    if found["way"] == "mid_block":
        return f"middle_block.{2 * place if kind == 'resnets' else 1}.{rest}"
    level, layers = int(found["level"]), unet.options.layers
    inner = 0 if kind == "resnets" else 1
    if found["way"] == "down_blocks":
        # The first block is the first convolution; each level ends in a block that halves.
        block = 1 + level * (layers + 1) + (layers if kind == "downsamplers" else place)
        return f"input_blocks.{block}.{'0.op' if kind == 'downsamplers' else f'{inner}.{rest}'}"
    block = level * (layers + 1) + (layers if kind == "upsamplers" else place)
    if kind == "upsamplers":  # behind the last block of its level, and its attention
        inner = 2 if unet.options.up[level] else 1
    return f"output_blocks.{block}.{inner}.{rest}"

"""Maps the layer names that LoRA tools use to layers of the networks.

diffusers and peft prefix a layer's name with the network's. sd-scripts ("kohya") replaces its dots
by underscores. Tools based on the original code of latent diffusion number the same layers
differently, as in ``input_blocks.4.1…``.
"""

__all__ = ["layers_by_name"]

import re
from collections.abc import Iterator

from torch import nn

from gsgen.reference_plugins.diffusion.unet import UNet

_KOHYA_PREFIX = "lora_unet_"
# Part of a residual block → its name in the original code.
_PART_NAMES = {
    "conv1": "in_layers.2",
    "time_emb_proj": "emb_layers.1",
    "conv2": "out_layers.3",
    "conv_shortcut": "skip_connection",
}
_NAMES_OUTSIDE_BLOCKS = {
    "conv_in": "input_blocks.0.0",
    "conv_out": "out.2",
    "time_embedding.linear_1": "time_embed.0",
    "time_embedding.linear_2": "time_embed.2",
    "add_embedding.linear_1": "label_emb.0.0",
    "add_embedding.linear_2": "label_emb.0.2",
}
_LAYER_NAME = re.compile(
    r"(?P<way>down_blocks|mid_block|up_blocks)(?:\.(?P<level>\d+))?"
    r"\.(?P<kind>resnets|attentions|downsamplers|upsamplers)\.(?P<place>\d+)\.(?P<rest>.+)"
)


def layers_by_name(unet: UNet, autoencoder: nn.Module | None) -> dict[str, nn.Module]:
    """Return all linear and convolution layers of U-Net and autoencoder, by each LoRA name."""
    layers: dict[str, nn.Module] = {}
    for name, layer in _named_layers(unet):
        for layer_name in (name, _original_name(name, unet)):
            layers |= {layer_name: layer, f"unet.{layer_name}": layer}
            layers |= {f"diffusion_model.{layer_name}": layer}
            layers[_KOHYA_PREFIX + layer_name.replace(".", "_")] = layer
    for name, layer in () if autoencoder is None else _named_layers(autoencoder):
        layers |= {name: layer, f"vae.{name}": layer}
    return layers


def _named_layers(network: nn.Module) -> Iterator[tuple[str, nn.Module]]:
    for name, layer in network.named_modules():
        if isinstance(layer, nn.Linear | nn.Conv2d):
            yield name, layer


def _original_name(name: str, unet: UNet) -> str:
    """Convert a U-Net layer name of diffusers to the name in the original latent diffusion code."""
    match = _LAYER_NAME.fullmatch(name)
    if match is None:
        return _NAMES_OUTSIDE_BLOCKS.get(name, name)
    kind, remaining_name, index = match["kind"], match["rest"], int(match["place"])
    if kind == "resnets":
        remaining_name = _PART_NAMES.get(remaining_name, remaining_name)
    if match["way"] == "mid_block":
        return f"middle_block.{2 * index if kind == 'resnets' else 1}.{remaining_name}"
    level, layers = int(match["level"]), unet.options.layers
    inner_index = 0 if kind == "resnets" else 1
    if match["way"] == "down_blocks":
        # The first block is the first convolution; each level ends with a downsampling block.
        block = 1 + level * (layers + 1) + (layers if kind == "downsamplers" else index)
        return f"input_blocks.{block}.{'0.op' if kind == 'downsamplers' else f'{inner_index}.{remaining_name}'}"
    block = level * (layers + 1) + (layers if kind == "upsamplers" else index)
    if kind == "upsamplers":  # after the last block of its level, and its attention
        inner_index = 2 if unet.options.up[level] else 1
    return f"output_blocks.{block}.{inner_index}.{remaining_name}"

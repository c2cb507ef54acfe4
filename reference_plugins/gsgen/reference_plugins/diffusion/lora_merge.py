"""Merges LoRA into the weights of networks, which then need no extra branches.

W′ = W + scale · α/r · B A (Hu et al. 2021, "LoRA", section 4.1), where A has r rows. For a
convolution, A has its kernel size and B is 1×1.
"""

__all__ = ["merge"]

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.reference_plugins.diffusion.lora import Adapter, Pair
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.states import first_names


def merge(adapter: Adapter, scale: float, homes: Mapping[str, nn.Module]) -> str:
    """Add a LoRA to the layers of networks in place, and return a summary.

    ``homes`` are the layers by each of their names. The error lists the first tensors without a
    layer, a partner or a fitting shape; no layer is changed then.
    """
    troubles = [
        f"{name} {trouble}"
        for name, pair in adapter.pairs.items()
        if (trouble := _mismatch(pair, homes.get(name)))
    ]
    if troubles or not adapter.pairs:
        raise CheckpointInvalid(
            f"{len(troubles)} of {len(adapter.pairs)} LoRA layers do not fit the networks: "
            f"{first_names(troubles, '; ')}",
            where=str(adapter.path),
            hint="The LoRA may have been trained for another network.",
        )
    shares = set()
    for name, pair in adapter.pairs.items():
        layer, down = homes[name], pair.down
        assert down is not None
        shares.add(share := adapter.share(name, pair, len(down)))
        weight = layer.weight
        assert isinstance(weight, Tensor)
        # A new tensor, because those of a file may share memory.
        merged = (weight.double() + scale * share * _product(pair, weight)).to(weight.dtype)
        layer.weight = nn.Parameter(merged, requires_grad=False)
    words = f"{min(shares):g}" + f" to {max(shares):g}" * (len(shares) > 1)
    return f"{adapter.path.name} × {scale:g} in {len(adapter.pairs)} layers, α/r {words}"


def _mismatch(pair: Pair, layer: nn.Module | None) -> str:
    """Return the reason why a LoRA change does not fit a layer; empty if it fits."""
    if layer is None:
        return "is not a layer of the networks"
    if pair.down is None or pair.up is None:
        return f"has no {'lora_A or down' if pair.down is None else 'lora_B or up'}"
    weight = layer.weight
    assert isinstance(weight, Tensor)
    down, up = _kernel(pair.down), _kernel(pair.up)
    fits = down.ndim == up.ndim == 4 and len(down) > 0 and up.shape[1:] == (len(down), 1, 1)
    if fits and (len(up), *down.shape[1:]) == _kernel(weight).shape:
        return ""
    actual = f"{list(pair.up.shape)} × {list(pair.down.shape)}"
    return f"has {actual}, which does not fit the weight {list(weight.shape)}"


def _product(pair: Pair, weight: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return the product B A of the LoRA matrices in float64, in the layer's weight shape."""
    assert pair.down is not None
    assert pair.up is not None
    down, up = _kernel(pair.down.double()), pair.up.double().flatten(1)
    return torch.einsum("or,rihw->oihw", up, down).reshape(weight.shape)


def _kernel(weight: Tensor) -> Tensor:
    return weight[:, :, None, None] if weight.ndim == 2 else weight

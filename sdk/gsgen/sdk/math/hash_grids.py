"""Multiresolution hash grids in 32-bit integers, which WebGPU runtimes compute."""

__all__ = ["hash_grid"]

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid

# Factors of the spatial hash, one per axis (Müller et al. 2022, equation 4).
_HASH_PRIMES = (1, 2654435761, 805459861)


def hash_grid(
    tables: Sequence[Float[Tensor, "t f"]],
    position: Float[Tensor, "n 3"],
    resolutions: Sequence[int],
) -> Float[Tensor, "n lf"]:
    """Sample a multiresolution hash grid trilinearly (Müller et al. 2022, "Instant-NGP").

    A level of R cells per axis has (R + 1)³ corners. Corner (x, y, z) has the feature at
    x + (R + 1)(y + (R + 1) z) if the table has room for all corners, else at
    (x ⊕ 2654435761 y ⊕ 805459861 z) mod T. Rewriting the export makes table look-ups of ⊕.

    Args:
        tables: The features of each level; the number of rows T is a power of two.
        position: In [0, 1]³; positions outside are clamped.
        resolutions: Cells per axis of each level.

    Returns:
        The features of all levels, concatenated.

    Raises:
        GeneratorInvalid: A size is not a power of two, or R · T exceeds 32-bit integers.
    """
    if len(tables) != len(resolutions):
        message = f"{len(tables)} tables, expected one for each of {len(resolutions)} resolutions"
        raise GeneratorInvalid(message, where="hash_grid")
    unit = position.clamp(0, 1)
    levels = [
        _sample_grid(table, unit, resolution)
        for table, resolution in zip(tables, resolutions, strict=True)
    ]
    return torch.cat(levels, dim=1)


def _sample_grid(
    table: Float[Tensor, "t f"], unit: Float[Tensor, "n 3"], resolution: int
) -> Float[Tensor, "n f"]:
    """Return one grid level's features: the weighted mean of the eight corners of each position."""
    offsets = torch.cartesian_prod(*[torch.tensor([0.0, 1.0], device=table.device)] * 3)
    scaled = unit * resolution
    low = torch.floor(scaled).clamp(0, resolution - 1)
    fraction = (scaled - low)[:, None]
    weights = offsets * fraction + (1 - offsets) * (1 - fraction)
    weight = weights[..., 0:1] * weights[..., 1:2] * weights[..., 2:3]
    corners = (low[:, None] + offsets).to(torch.int32)
    rows = _rows(corners, table.shape[0], resolution)
    features = table.index_select(0, rows.reshape(-1)).reshape(-1, 8, table.shape[1])
    return (features * weight).sum(dim=1)


def _rows(corners: Int[Tensor, "n 8 3"], size: int, resolution: int) -> Int[Tensor, "n 8"]:
    """Return the row index in the hash table of each grid corner's feature."""
    vertices_per_side = resolution + 1
    x, y, z = corners.unbind(dim=-1)
    if vertices_per_side**3 <= size:
        return x + vertices_per_side * (y + vertices_per_side * z)
    if size & (size - 1) or resolution * size > torch.iinfo(torch.int32).max:
        message = f"the hash table has {size} rows for a resolution of {resolution}"
        raise GeneratorInvalid(
            f"{message}, expected a power of two, and resolution × rows below 2³¹",
            where="hash_grid",
        )
    # Only the lowest bits of a product count, and these depend on those of the prime alone.
    factors = [prime % size for prime in _HASH_PRIMES]
    return ((x * factors[0]) ^ (y * factors[1]) ^ (z * factors[2])) % size

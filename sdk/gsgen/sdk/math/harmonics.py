"""Converts spherical harmonics from the layouts of 3DGS methods to the packed [N, K, 3]."""

__all__ = [
    "sh_from_channel_major",
    "sh_from_coefficient_major",
    "sh_from_ply",
    "sh_from_rgb",
    "sh_of_degree",
]

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE, SH_COEFFICIENT_COUNTS, coefficients
from gsgen.sdk.errors import GeneratorInvalid

# The constant basis function, ½ √(1/π).
_SH_CONSTANT_TERM = 0.28209479177387814


def sh_from_channel_major(sh: Float[Tensor, "n ..."]) -> Float[Tensor, "n k 3"]:
    """Reorder SH coefficients that are stored channel by channel (all red, green, blue).

    Args:
        sh: [N, 3, K], or [N, 3K] with all red coefficients first.

    Raises:
        GeneratorInvalid: The shape is another one, or K is not 1, 4, 9 or 16.
    """
    parts = sh.reshape(sh.shape[0], 3, -1) if _is_flat_sh(sh) else sh
    if parts.ndim != 3 or parts.shape[1] != 3 or parts.shape[2] not in SH_COEFFICIENT_COUNTS:
        raise _wrong_shape_error("sh_from_channel_major", sh, "[N, 3, K] or [N, 3K]")
    return parts.transpose(1, 2)


def sh_from_coefficient_major(sh: Float[Tensor, "n ..."]) -> Float[Tensor, "n k 3"]:
    """Reshape SH coefficients that are stored one after another, each as red, green, blue.

    Args:
        sh: [N, K, 3], or [N, 3K] with the constant term first.

    Raises:
        GeneratorInvalid: The shape is another one, or K is not 1, 4, 9 or 16.
    """
    parts = sh.reshape(sh.shape[0], -1, 3) if _is_flat_sh(sh) else sh
    if parts.ndim != 3 or parts.shape[2] != 3 or parts.shape[1] not in SH_COEFFICIENT_COUNTS:
        raise _wrong_shape_error("sh_from_coefficient_major", sh, "[N, K, 3] or [N, 3K]")
    return parts


def sh_from_ply(
    constant: Float[Tensor, "n 3"], f_rest: Float[Tensor, "n m"]
) -> Float[Tensor, "n k 3"]:
    """Join the SH columns of a 3DGS PLY file to coefficients [N, K, 3].

    Args:
        constant: f_dc_0 … f_dc_2, one column per channel.
        f_rest: f_rest_0 …, in the order of their numbers: all red columns, then green, then
            blue; 0, 9, 24 or 45 columns.

    Raises:
        GeneratorInvalid: The number of columns is another one.
    """
    n, columns = f_rest.shape
    if constant.shape != (n, 3) or columns % 3 or columns // 3 + 1 not in SH_COEFFICIENT_COUNTS:
        raise _wrong_shape_error("sh_from_ply, rest", f_rest, "[N, 0], [N, 9], [N, 24] or [N, 45]")
    if not columns:
        return constant[:, None, :]
    return torch.cat([constant[:, None, :], f_rest.reshape(n, 3, -1).transpose(1, 2)], dim=1)


def sh_from_rgb(rgb: Float[Tensor, "n 3"]) -> Float[Tensor, "n 1 3"]:
    """Return SH of degree 0 with the colour ``rgb`` in every direction: ½ + Y₀ c₀ = rgb."""
    return ((rgb - 0.5) / _SH_CONSTANT_TERM)[:, None, :]


def sh_of_degree(sh: Float[Tensor, "n k 3"], degree: int) -> Float[Tensor, "n l 3"]:
    """Truncate SH coefficients to a degree, or pad them to the degree with zeros.

    Args:
        sh: Coefficient-major coefficients.
        degree: From 0 to 3.

    Raises:
        GeneratorInvalid: The degree is not 0 to 3.
    """
    if not 0 <= degree <= MAX_DEGREE:
        message = f"degree is {degree}, expected 0 to {MAX_DEGREE}"
        raise GeneratorInvalid(message, where="sh_of_degree")
    count = coefficients(degree)
    missing = count - sh.shape[1]
    if missing <= 0:
        return sh[:, :count]
    return torch.cat([sh, sh.new_zeros(sh.shape[0], missing, 3)], dim=1)


def _is_flat_sh(sh: Tensor) -> bool:
    return sh.ndim == 2 and sh.shape[1] % 3 == 0


def _wrong_shape_error(where: str, sh: Tensor, expected: str) -> GeneratorInvalid:
    message = f"shape is {list(sh.shape)}, expected {expected} with K = 1, 4, 9 or 16"
    return GeneratorInvalid(message, where=where)

"""Checks what a torch module returns in eager mode, before anything is traced or compared.

A number that is wrong in torch is wrong in the exported model, too: named here, it is not mistaken
for a difference between the two.
"""

__all__ = ["check_gaussians"]

from collections.abc import Iterator

import torch
from torch import Tensor

from gsgen.contract.spec.layout import CULL_OPACITY
from gsgen.sdk.authoring.generator import Gaussians
from gsgen.sdk.errors import GeneratorInvalid

_SPLAT_FIELDS = ("position", "opacity", "scale", "rotation", "covariance", "sh", "rgb")
_CELL_FIELDS = ("position", "visibility", "scale", "rotation", "covariance")
_NOT_FINITE_TEXT = (
    "Find the division, logarithm, root or norm that sees 0, and clamp what it takes, for example "
    "with .clamp(min=1e-6); gsgen.sdk.math.safe_normalize divides by a norm."
)


def check_gaussians(gaussians: Gaussians, count: int, inputs: str) -> None:
    """Raise if live rows that a torch module returned hold NaN, logits, logarithms or zero quaternions.

    Args:
        gaussians: The result of the module.
        count: Number of live rows.
        inputs: The label of the test inputs.

    Raises:
        GeneratorInvalid: A value is not finite, or most opacities, scales or rotations are wrong.
    """
    for where, values in _fields(gaussians, count):
        _refuse_not_finite(where, values, inputs)
    if gaussians.scale is not None:
        _refuse_logarithms(gaussians.scale[:count])
    if gaussians.cells is None:
        _refuse_logits(gaussians.opacity[:count].reshape(-1))
    if gaussians.rotation is not None:
        is_drawn = gaussians.opacity[:count].reshape(-1) >= CULL_OPACITY
        _refuse_invalid_rotation(gaussians.rotation[:count][is_drawn], inputs)


def _fields(gaussians: Gaussians, count: int) -> Iterator[tuple[str, Tensor]]:
    """Yield each field of the live Gaussians and of the cells, with its name in error messages."""
    for name in _SPLAT_FIELDS:
        if (values := getattr(gaussians, name)) is not None:
            yield f"Gaussians.{name}", values[:count]
    for name in _CELL_FIELDS if gaussians.cells is not None else ():
        if (values := getattr(gaussians.cells, name)) is not None:
            yield f"Cells.{name}", values


def _refuse_not_finite(where: str, values: Tensor, inputs: str) -> None:
    # The bounds need no copy of the values, and are NaN if a value is.
    if not values.numel() or all(bound.isfinite() for bound in values.aminmax()):
        return
    invalid_count = int((~torch.isfinite(values)).reshape(len(values), -1).any(dim=1).sum())
    has_nan_values, has_infinite_values = bool(values.isnan().any()), bool(values.isinf().any())
    kinds = " or ".join(["NaN"] * has_nan_values + ["infinity"] * has_infinite_values)
    raise GeneratorInvalid(
        f"{kinds} in {invalid_count:,} of {len(values):,} rows at {inputs!r}; expected finite numbers",
        where=where,
        hint=_NOT_FINITE_TEXT,
    )


def _refuse_logarithms(scale: Tensor) -> None:
    """Raise if most scales of Gaussians are negative, because they are probably logarithms.

    Single negative scales are accepted: methods that add an offset to a scale
    (Deformable-3D-Gaussians) have them, and draw their squares.
    """
    invalid_count = int((scale < 0).all(dim=1).sum())
    if invalid_count > len(scale) / 2:
        raise GeneratorInvalid(
            f"the scale is negative in {invalid_count:,} of {len(scale):,} rows, down to "
            f"{float(scale.min()):g}; expected standard deviations",
            where="Gaussians.scale",
            hint="3DGS stores logarithms: take torch.exp of them; or take abs, if signs have no meaning.",
        )


def _refuse_logits(opacity: Tensor) -> None:
    """Raise if most opacities lie outside 0 to 1, because they are probably logits."""
    invalid_count = int(((opacity < 0) | (opacity > 1)).sum())
    if invalid_count > len(opacity) / 2:
        raise GeneratorInvalid(
            f"the opacity is outside 0 to 1 in {invalid_count:,} of {len(opacity):,} rows, from "
            f"{float(opacity.min()):g} to {float(opacity.max()):g}; expected opacities",
            where="Gaussians.opacity",
            hint="3DGS stores logits: take torch.sigmoid of them.",
        )


def _refuse_invalid_rotation(rotation: Tensor, inputs: str) -> None:
    """Raise if most drawn Gaussians have a quaternion of zeros.

    Single ones are accepted: a trained scene may hold a few, and they are drawn unrotated.
    """
    invalid_count = int((rotation == 0).all(dim=1).sum())
    if invalid_count > len(rotation) / 2:
        raise GeneratorInvalid(
            f"the rotation has norm 0 in {invalid_count:,} of {len(rotation):,} visible rows at {inputs!r}; "
            "expected unit quaternions (w, x, y, z)",
            where="Gaussians.rotation",
            hint="The quaternion of no rotation is (1, 0, 0, 0).",
        )

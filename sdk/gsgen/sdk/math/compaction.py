"""Selects rows with static shapes: a fixed number of row indices, and a count of valid ones.

Rows are sorted by TopK, which ONNX Runtime's WebGPU provider captures; onnxruntime-web 1.22 has no
kernel for it. If that matters, multiply opacity by the mask instead.
"""

__all__ = ["keep_rows", "top_rows"]

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid

# Row indices are sorted as float32, which represents integers up to this number.
_MAX_ROWS = 1 << 24


def keep_rows(
    mask: Float[Tensor, " n"], capacity: int
) -> tuple[Int[Tensor, " c"], Int[Tensor, "1"]]:
    """Return the row indices that a mask keeps, followed by other rows, and the kept count.

    Args:
        mask: Above zero for rows to keep.
        capacity: Maximum number of rows to keep; of more rows, the first ones are kept.

    Returns:
        Row indices int32 [min(capacity, n)] and the count int32 [1]. From the count on, the
        indices are those of removed rows. :meth:`gsgen.sdk.Gaussians.take` takes both.

    Raises:
        GeneratorInvalid: The capacity is below one, or there are more than 2²⁴ rows.
    """
    n, size = _sizes(mask, capacity, "keep_rows")
    order = torch.arange(n, 0, -1, dtype=torch.float32, device=mask.device)
    retained = (mask > 0).to(torch.float32)
    rows = torch.topk(retained * order, size).indices.to(torch.int32)
    count = retained.sum(dim=0, keepdim=True).clamp(max=size).to(torch.int32)
    return rows, count


def top_rows(score: Float[Tensor, " n"], capacity: int) -> Int[Tensor, " c"]:
    """Return the indices of the rows with the highest scores, highest first.

    Args:
        score: A number per row, such as opacity times size on the image.
        capacity: Number of rows to take; all rows if there are fewer.

    Raises:
        GeneratorInvalid: The capacity is below one.
    """
    _, size = _sizes(score, capacity, "top_rows")
    return torch.topk(score, size).indices.to(torch.int32)


def _sizes(values: Tensor, capacity: int, where: str) -> tuple[int, int]:
    n = values.shape[0]
    if capacity < 1:
        raise GeneratorInvalid(f"the capacity is {capacity}, expected 1 or more", where=where)
    if n > _MAX_ROWS:
        message = f"the mask or scores have {n} rows, expected {_MAX_ROWS} at most"
        raise GeneratorInvalid(message, where=where, hint="Select rows in several parts.")
    return n, min(capacity, n)

"""Choose rows without a shape that depends on data: a fixed number of them, and a count.

Rows are sorted by TopK, which ONNX Runtime's WebGPU provider captures; onnxruntime-web 1.22 has no
kernel for it. Where that matters, multiply opacity by the mask instead.
"""

__all__ = ["keep_rows", "top_rows"]

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gsgen.sdk.errors import GeneratorInvalid

# Row numbers are sorted as float32, which holds all of them up to here.
_MOST_ROWS = 1 << 24


def keep_rows(
    mask: Float[Tensor, " n"], capacity: int
) -> tuple[Int[Tensor, " c"], Int[Tensor, "1"]]:
    """Return the numbers of the rows to keep, in order and in front, and how many they are.

    Args:
        mask: Above zero where a row stays.
        capacity: How many rows can stay; of more than that, the first do.

    Returns:
        Row numbers int32 [min(capacity, n)], of which those at and behind the count are rows that
        do not stay, and the count, int32 [1]. :meth:`gsgen.sdk.Gaussians.take` takes both.

    Raises:
        GeneratorInvalid: The capacity is below one, or there are more than 2²⁴ rows.
    """
    n, size = _sizes(mask, capacity, "keep_rows")
    order = torch.arange(n, 0, -1, dtype=torch.float32, device=mask.device)
    kept = (mask > 0).to(torch.float32)
    rows = torch.topk(kept * order, size).indices.to(torch.int32)
    count = kept.sum(dim=0, keepdim=True).clamp(max=size).to(torch.int32)
    return rows, count


def top_rows(score: Float[Tensor, " n"], capacity: int) -> Int[Tensor, " c"]:
    """Return the numbers of the rows with the highest scores, highest first.

    Args:
        score: Such as opacity times size on the image.
        capacity: How many rows to take; all where there are fewer.

    Raises:
        GeneratorInvalid: The capacity is below one.
    """
    _, size = _sizes(score, capacity, "top_rows")
    return torch.topk(score, size).indices.to(torch.int32)


def _sizes(values: Tensor, capacity: int, where: str) -> tuple[int, int]:
    n = values.shape[0]
    if capacity < 1:
        raise GeneratorInvalid(f"capacity is {capacity}, wanted 1 or more", where=where)
    if n > _MOST_ROWS:
        what = f"{n} rows, wanted {_MOST_ROWS} at most"
        raise GeneratorInvalid(what, where=where, hint="Choose in several parts.")
    return n, min(capacity, n)

"""Writes torch functions so that torch's exporter knows sizes that depend on values."""

__all__ = ["OneHotWithoutValues", "SharedMasks"]

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.overrides import TorchFunctionMode


class OneHotWithoutValues(TorchFunctionMode):
    """Computes ``one_hot`` of a given number of classes by a comparison.

    Torch's own reads the smallest and the largest value, to check them.
    """

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Call a torch function, or compare where it is ``one_hot``."""
        options = kwargs or {}
        if func is not functional.one_hot:
            return func(*args, **options)
        classes = args[1] if len(args) > 1 else options.get("num_classes", -1)
        values = args[0] if args else options["tensor"]
        if classes <= 0:
            return func(*args, **options)
        return (values.unsqueeze(-1) == torch.arange(classes)).long()


class SharedMasks(nn.Module):
    """Runs a module, and counts the true elements of a mask once for all tensors it selects from.

    Torch's exporter gives each selection a size of its own, and cannot join two of them.
    """

    def __init__(self, module: nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, *inputs: Tensor) -> Any:
        """Return the result of the module."""
        with _SharedIndices():
            return self.module(*inputs)


class _SharedIndices(TorchFunctionMode):
    """Replaces ``x[mask]`` by ``x[rows]``, the rows of a mask [n] being found once."""

    def __init__(self) -> None:
        super().__init__()
        self._rows_by_mask: dict[int, tuple[Tensor, Tensor]] = {}  # with the mask, to keep its id

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is Tensor.__getitem__ and _is_row_mask(args[1]):
            return args[0][self._rows(args[1])]
        return func(*args, **(kwargs or {}))

    def _rows(self, mask: Tensor) -> Tensor:
        if id(mask) not in self._rows_by_mask:
            self._rows_by_mask[id(mask)] = mask, torch.nonzero(mask).squeeze(1)
        return self._rows_by_mask[id(mask)][1]


def _is_row_mask(index: Any) -> bool:
    return isinstance(index, Tensor) and index.dtype == torch.bool and index.ndim == 1

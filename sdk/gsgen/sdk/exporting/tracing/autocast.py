"""Switches off mixed precision while a module is exported."""

__all__ = ["float32_arithmetic"]

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

_AUTOCAST_WARNING = (
    "forward uses autocast, which was switched off: the model computes in float32, "
    "and may differ from training in its last digits"
)


@contextmanager
def float32_arithmetic(notes: list[str]) -> Iterator[None]:
    """Disable ``torch.autocast`` while modules run and are traced; add a note if one uses it.

    ONNX Runtime has no kernels for bfloat16 on the CPU, nor WebGPU for any mixture of dtypes.
    """
    original_methods = {name: getattr(torch.autocast, name) for name in ("__enter__", "__exit__")}

    def enter_autocast(self: Any) -> Any:
        if _AUTOCAST_WARNING not in notes:
            notes.append(_AUTOCAST_WARNING)
        return self

    def exit_autocast(*_: Any) -> None:
        """Do nothing, in place of the exit of a ``torch.autocast`` context."""

    for name, method in zip(original_methods, (enter_autocast, exit_autocast), strict=True):
        setattr(torch.autocast, name, method)
    try:
        yield
    finally:
        for name, method in original_methods.items():
            setattr(torch.autocast, name, method)

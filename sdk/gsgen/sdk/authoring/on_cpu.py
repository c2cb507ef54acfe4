"""Runs code that was written for a GPU by CUDA on the CPU."""

__all__ = ["on_cpu"]

from contextlib import ContextDecorator
from types import TracebackType
from typing import Any, Final, Self

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_map

_CUDA: Final = "cuda"
# The serialisation of torch asks functions of lower numbers first; CUDA's own has the number 20.
_LOADING_PRIORITY: Final = 15


class on_cpu(ContextDecorator):  # noqa: N801  (read as a function, such as torch.no_grad)
    """Keep tensors on the CPU that code sends to a CUDA device.

    Inside of the block, ``tensor.cuda()``, ``module.cuda()``, ``.to("cuda")``, ``device="cuda"`` of
    torch's functions, ``pin_memory`` and files of tensors that were saved on a GPU give tensors of
    the CPU. Calls into the driver, such as ``torch.cuda.synchronize()``, and kernels of their own
    fail as before. For example::

        with gsgen.sdk.on_cpu():
            model = authors_package.Model().cuda()

    It is a decorator, too. Exports run inside of it.
    """

    _is_loader_registered = False
    _depth = 0

    def __enter__(self) -> Self:
        self._register_loader()
        self._modes = [*getattr(self, "_modes", ()), _KeepOnCpu()]
        self._modes[-1].__enter__()
        on_cpu._depth += 1
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        on_cpu._depth -= 1
        self._modes.pop().__exit__(kind, error, trace)

    @classmethod
    def _register_loader(cls) -> None:
        """Let ``torch.load`` place tensors of a GPU on the CPU; torch has no way to take it back."""
        if not cls._is_loader_registered:
            on_cpu._is_loader_registered = True
            torch.serialization.register_package(_LOADING_PRIORITY, lambda _: None, _place_on_cpu)


def _place_on_cpu(storage: Any, location: str) -> Any:
    """Return a storage on the CPU that a file says is on a GPU; None leaves it to torch."""
    return storage if on_cpu._depth and location.startswith(_CUDA) else None


class _KeepOnCpu(TorchFunctionMode):
    """Replaces CUDA devices by the CPU in the arguments of torch's functions."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func in (Tensor.cuda, Tensor.pin_memory):
            return args[0]
        options = dict(kwargs or {})
        options.pop("pin_memory", None)
        if not _names_cuda((args, options)):
            return func(*args, **options)
        if func is torch.device:
            return torch.device("cpu")
        return func(*tree_map(_cpu_instead, args), **tree_map(_cpu_instead, options))


def _names_cuda(arguments: Any) -> bool:
    positional, options = arguments
    return any(map(_is_cuda, (*positional, *options.values())))


def _is_cuda(value: Any) -> bool:
    if isinstance(value, torch.device):
        return value.type == _CUDA
    return isinstance(value, str) and value.partition(":")[0] == _CUDA


def _cpu_instead(value: Any) -> Any:
    return torch.device("cpu") if _is_cuda(value) else value

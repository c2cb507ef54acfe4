"""Runs code that was written for a GPU by CUDA on the CPU."""

__all__ = ["on_cpu"]

from contextlib import AbstractContextManager, ContextDecorator
from types import TracebackType
from typing import Any, Final, Self

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_map

from gsgen.sdk.authoring.cuda_stand_ins import is_cuda, stand_ins_for_cuda

# The serialisation of torch asks functions of lower numbers first; CUDA's own has the number 20.
_LOADING_PRIORITY: Final = 15
# What torch.Tensor.type takes, such as torch.cuda.FloatTensor.
_TYPE_PREFIX: Final = "torch.cuda."


class on_cpu(ContextDecorator):  # noqa: N801  (read as a function, such as torch.no_grad)
    """Keep tensors on the CPU that code sends to a CUDA device.

    Inside of the block, ``tensor.cuda()``, ``module.cuda()``, ``.to("cuda")``, ``device="cuda"`` of
    torch's functions, ``pin_memory`` and files of tensors that were saved on a GPU give tensors of
    the CPU. Calls into the driver, such as ``torch.cuda.synchronize()``, streams and events return
    at once, and no memory is in use; ``torch.cuda.is_available()`` says what it did before. Kernels
    of their own fail as before. For example::

        with gsgen.sdk.on_cpu():
            model = authors_package.Model().cuda()

    It is a decorator, too. Exports run inside of it.
    """

    _is_loader_registered = False
    _depth = 0
    _stand_ins: AbstractContextManager[None] | None = None

    def __enter__(self) -> Self:
        self._register_loader()
        self._modes = [*getattr(self, "_modes", ()), _KeepOnCpu()]
        self._modes[-1].__enter__()
        if not on_cpu._depth:
            on_cpu._stand_ins = stand_ins_for_cuda()
            on_cpu._stand_ins.__enter__()
        on_cpu._depth += 1
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        on_cpu._depth -= 1
        if not on_cpu._depth and on_cpu._stand_ins is not None:
            on_cpu._stand_ins.__exit__(None, None, None)
        self._modes.pop().__exit__(kind, error, trace)

    @classmethod
    def _register_loader(cls) -> None:
        """Let ``torch.load`` place tensors of a GPU on the CPU; torch has no way to take it back."""
        if not cls._is_loader_registered:
            on_cpu._is_loader_registered = True
            torch.serialization.register_package(_LOADING_PRIORITY, lambda _: None, _place_on_cpu)


def _place_on_cpu(storage: Any, location: str) -> Any:
    """Return a storage on the CPU that a file says is on a GPU; None leaves it to torch."""
    return storage if on_cpu._depth and is_cuda(location) else None


class _KeepOnCpu(TorchFunctionMode):
    """Replaces CUDA devices by the CPU in the arguments of torch's functions."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func in (Tensor.cuda, Tensor.pin_memory):
            return args[0]
        options = dict(kwargs or {})
        options.pop("pin_memory", None)
        if not any(map(_names_cuda, (*args, *options.values()))):
            return func(*args, **options)
        if func is torch.device:
            return torch.device("cpu")
        return func(*tree_map(_cpu_instead, args), **tree_map(_cpu_instead, options))


def _names_cuda(value: Any) -> bool:
    return is_cuda(value) or (isinstance(value, str) and value.startswith(_TYPE_PREFIX))


def _cpu_instead(value: Any) -> Any:
    if is_cuda(value):
        return torch.device("cpu")
    return value.replace(_TYPE_PREFIX, "torch.") if _names_cuda(value) else value

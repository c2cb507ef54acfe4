"""What calls into CUDA's driver answer on the CPU: nothing to wait for, no memory, no second device."""

__all__ = ["is_cuda", "stand_ins_for_cuda"]

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from types import SimpleNamespace
from typing import Any, Final

import torch

CUDA: Final = "cuda"


def is_cuda(value: Any) -> bool:
    """Return whether an argument names a CUDA device."""
    if isinstance(value, torch.device):
        return value.type == CUDA
    return isinstance(value, str) and value.partition(":")[0] == CUDA


def _nothing(*_: Any, **__: Any) -> None:
    """Do nothing: on the CPU, all work is done when a call returns."""


def _returns(value: Any) -> Callable[..., Any]:
    return lambda *_, **__: value


def _each(names: Iterable[str], value: Any) -> dict[str, Callable[..., Any]]:
    """Return a function for each name; torch's compiler rejects one function of several names."""
    return {name: _returns(value) for name in names}


class _Event:
    """An event of a stream that has always happened; the time between two is that of the clock."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self._seconds = time.perf_counter()

    def record(self, *_: Any) -> None:
        self._seconds = time.perf_counter()

    def elapsed_time(self, end: "_Event") -> float:
        """Return the milliseconds from this event to another."""
        return 1000 * (end._seconds - self._seconds)

    query = staticmethod(_returns(True))
    synchronize = wait = staticmethod(_nothing)


class _NoContext(nullcontext[None]):
    """A context of a device or of a stream, which changes nothing."""

    def __init__(self, *_: Any) -> None:
        super().__init__()


class _Stream:
    """A stream whose work is done when it is enqueued."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.device = torch.device("cpu")

    def record_event(self, event: _Event | None = None) -> _Event:
        """Return an event that happens now."""
        event = event or _Event()
        event.record()
        return event

    query = staticmethod(_returns(True))
    synchronize = wait_stream = wait_event = staticmethod(_nothing)


class _GeneratorType(type):
    """The type of a type that has all generators of torch as instances."""

    def __instancecheck__(cls, instance: Any) -> bool:
        return isinstance(instance, _TORCH_GENERATOR)


_TORCH_GENERATOR: Final = torch.Generator
_SET_DEFAULT_DEVICE: Final = torch.set_default_device


class _Generator(metaclass=_GeneratorType):
    """Makes generators of random numbers on the CPU."""

    def __new__(cls, device: Any = "cpu") -> Any:
        return _TORCH_GENERATOR("cpu" if is_cuda(device) else device)


def _set_default_device(device: Any) -> None:
    _SET_DEFAULT_DEVICE("cpu" if is_cuda(device) else device)


def _memory() -> tuple[int, int]:
    """Return the free and the whole memory of the machine, in bytes."""
    page = os.sysconf("SC_PAGE_SIZE")
    return page * os.sysconf("SC_AVPHYS_PAGES"), page * os.sysconf("SC_PHYS_PAGES")


def _properties(*_: Any) -> SimpleNamespace:
    return SimpleNamespace(
        name="cpu",
        major=0,
        minor=0,
        total_memory=_memory()[1],
        multi_processor_count=os.cpu_count() or 1,
    )


_CUDA_ANSWERS: Final[dict[str, Any]] = {
    **_each(
        (
            *("synchronize", "set_device", "set_stream", "empty_cache", "ipc_collect", "init"),
            *("manual_seed", "manual_seed_all", "seed", "seed_all"),
            *("reset_peak_memory_stats", "reset_max_memory_allocated", "reset_max_memory_cached"),
            *("reset_accumulated_memory_stats", "set_per_process_memory_fraction"),
            "set_sync_debug_mode",
        ),
        None,
    ),
    **_each(
        (
            *("memory_allocated", "max_memory_allocated", "memory_reserved", "max_memory_reserved"),
            *("memory_cached", "max_memory_cached", "current_device", "utilization"),
        ),
        0,
    ),
    # torch's tracer asks what is an instance of them.
    **{name: type(name, (_NoContext,), {}) for name in ("device", "device_of", "StreamContext")},
    "stream": _NoContext,
    **_each(("current_stream", "default_stream"), _Stream()),
    "Stream": _Stream,
    "ExternalStream": type("_ExternalStream", (_Stream,), {}),
    **{
        name: getattr(torch, name)
        for name in dir(torch.cuda)
        if name.endswith("Tensor") and hasattr(torch, name)
    },
    "Event": _Event,
    "mem_get_info": lambda *_: _memory(),
    "memory_stats": _returns({}),
    "memory_summary": _returns(""),
    "get_device_name": _returns("cpu"),
    "get_device_capability": _returns((0, 0)),
    "get_device_properties": _properties,
    "get_rng_state": lambda *_: torch.get_rng_state(),
    "set_rng_state": lambda state, *_: torch.set_rng_state(state),
    "is_bf16_supported": _returns(False),
    "initial_seed": lambda: torch.initial_seed(),
}
_NVTX_ANSWERS: Final = {
    **_each(("range_push", "range_pop", "range_start", "range_end", "mark"), None),
    "range": _returns(nullcontext()),
}
_TABLES: Final[tuple[tuple[Any, dict[str, Any]], ...]] = (
    (torch.cuda, _CUDA_ANSWERS),
    (torch.cuda.nvtx, _NVTX_ANSWERS),
    (torch, {"Generator": _Generator, "set_default_device": _set_default_device}),
    (torch.Tensor, {"record_stream": _nothing}),
)


@contextmanager
def stand_ins_for_cuda() -> Iterator[None]:
    """Answer calls into CUDA's driver on the CPU, inside of the block and in all threads."""
    known = [
        (owner, name, vars(owner).get(name), answer)
        for owner, answers in _TABLES
        for name, answer in answers.items()
        if hasattr(owner, name)
    ]
    for owner, name, _, answer in known:
        setattr(owner, name, answer)
    has_rules = _compiler_rules() is not None
    try:
        yield
    finally:
        for owner, name, original, _ in known:
            if original is None:
                delattr(owner, name)
            else:
                setattr(owner, name, original)
        if not has_rules and (rules := _compiler_rules()) is not None:
            rules.cache_clear()


def _compiler_rules() -> Any:
    """Return the table of torch's functions that its compiler has made; None if it has made none."""
    module = sys.modules.get("torch._dynamo.trace_rules")
    rules = getattr(module, "get_torch_obj_rule_map", None)
    return rules if rules is not None and rules.cache_info().currsize else None

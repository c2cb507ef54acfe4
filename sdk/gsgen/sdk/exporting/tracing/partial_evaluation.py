"""Computes what no input reaches before the trace, so that it is a constant of the graph.

A torch module may index a list with an element of a buffer, select by a mask of its parameters,
invert a constant matrix or branch on one. Torch's exporter refuses all of it, since it treats
parameters and buffers as data. Here ``forward`` runs on real tensors: an operation that reads no
tensor which an input has written runs at once, and its result is a constant of the graph. The
others are recorded by torch's ``make_fx``.
"""

__all__ = ["ConstantFolding", "ValueNeeded", "fold_constants"]

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, fx, nn
from torch.fx.experimental.proxy_tensor import disable_proxy_modes_tracing, make_fx
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

from gsgen.contract.spec.units import format_bytes
from gsgen.sdk.exporting.tracing.fixed_sizes import OneHotWithoutValues
from gsgen.sdk.exporting.tracing.folded_constants import FoldedConstants
from gsgen.sdk.exporting.tracing.repeatability import find_unrepeatable
from gsgen.sdk.exporting.tracing.source_lines import current_user_line

_INDEX_OVERLOAD_PACKETS = (
    torch.ops.aten.index,
    torch.ops.aten.index_put,
    torch.ops.aten.index_put_,
)
_CLAMP_OPERATORS = (torch.ops.aten.clamp.default, torch.ops.aten.clamp_.default)
# Runs that look for tensors which are constant when they are made and written later. Each run adds
# tensors that the one before it did not know; two are the most that a module has needed.
_MAX_RUNS = 8
# A constant of this size is worth a note: the file grows by it.
_LARGE_TABLE_BYTES = 16 << 20


class ValueNeeded(Exception):
    """``forward`` needs the value of a tensor that depends on an input, to go on in Python.

    Attributes:
        where: The line of the user's code, as ``file:line (code)``.
        is_shape: Whether the value decides the shape of a result.
    """

    def __init__(self, operation: str, where: str, *, is_shape: bool) -> None:
        super().__init__(f"{operation} needs the values of a tensor that depends on an input")
        self.where, self.is_shape = where, is_shape


@dataclass(frozen=True, slots=True)
class ConstantFolding:
    """A module as a graph, without the operations that no input reaches.

    Attributes:
        graph: The graph; its arguments are those of the module, its constants are attributes.
        counts: The operations that were computed before the trace, and the size of the constants of
            the graph besides parameters and buffers.
        largest: The line that makes the largest of those constants, and its size in bytes.
        unrepeatable: The line whose value changes from run to run; empty without one.
    """

    graph: fx.GraphModule
    counts: FoldedConstants
    largest: tuple[str, int] = ("", 0)
    unrepeatable: str = ""

    def describe(self) -> list[str]:
        """Return sentences for the user."""
        size = format_bytes(self.counts.nbytes)
        notes = [
            f"{self.counts.operations} operations that no input reaches are constants of {size}."
        ]
        line, nbytes = self.largest
        if nbytes >= _LARGE_TABLE_BYTES:
            notes.append(
                f"{line or 'forward'}: a table of {format_bytes(nbytes)} is stored in the file."
            )
        if self.unrepeatable:
            notes.append(
                f"{self.unrepeatable}: gives another value in each run; the file keeps that of the export."
            )
        return notes


def fold_constants(module: nn.Module, inputs: Sequence[Tensor]) -> ConstantFolding:
    """Run a torch module, and return the graph of the operations that an input reaches.

    Args:
        module: A module that returns tensors.
        inputs: Its arguments; the graph has their shapes.

    Raises:
        ValueNeeded: ``forward`` needs the value of a tensor that depends on an input.
    """
    with torch.no_grad(), _restored_tensors(module):
        # Step 1: find tensors that are constant when they are made, and that an input writes later.
        written: frozenset[int] = frozenset()
        for _ in range(_MAX_RUNS):
            folded_tensors = written | _run(module, _copy_tensors(inputs), written).written
            if folded_tensors == written:
                break
            written = folded_tensors

        # Step 2: record all operations that an input reaches, and those that make such tensors.
        modes: list[_PartialEvaluation] = []

        def recorded(*tensors: Tensor) -> Any:
            with OneHotWithoutValues(), _PartialEvaluation(tensors, written) as mode:
                modes.append(mode)
                return module(*tensors)

        trace: Callable[..., fx.GraphModule] = make_fx(
            recorded, tracing_mode="real", _error_on_data_dependent_ops=False
        )
        graph = trace(*_copy_tensors(inputs))
        unrepeatable = find_unrepeatable(module, inputs)
    known = {t.data_ptr() for t in (*module.parameters(), *module.buffers())}
    constants = {t.data_ptr(): t for t in _constants(graph) if t.data_ptr() not in known}
    largest = max(constants.values(), key=lambda tensor: tensor.nbytes, default=None)
    return ConstantFolding(
        graph=graph,
        counts=FoldedConstants(modes[-1].computed, sum(t.nbytes for t in constants.values())),
        largest=("", 0)
        if largest is None
        else (modes[-1].large_lines.get(_storage(largest), ""), largest.nbytes),
        unrepeatable="" if unrepeatable is None else unrepeatable.where,
    )


def _run(
    module: nn.Module, inputs: Sequence[Tensor], written: frozenset[int]
) -> "_PartialEvaluation":
    mode = _PartialEvaluation(inputs, written)
    with OneHotWithoutValues(), mode:
        module(*inputs)
    return mode


class _PartialEvaluation(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Marks the tensors that an input reaches, and keeps all others out of the trace.

    Tensors are marked by their storage, so that a view of a written tensor counts, too.

    Attributes:
        computed: The number of operations that no input reaches.
        written: The operations, by their number, whose result an input writes later.
        large_lines: The storage of each large constant → the line of the user's code that made it.
    """

    def __init__(self, inputs: Sequence[Tensor], written: frozenset[int]) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.computed = 0
        self.written: set[int] = set()
        self.large_lines: dict[int, str] = {}
        self._known_written_tensors = written
        # The storage's address → a tensor of it, which keeps the address from being used again.
        self._reached_tensors: dict[int, Tensor] = {}
        self._maker_by_storage: dict[
            int, tuple[int, Tensor]
        ] = {}  # the operation that made a storage
        self._plain_tensors: dict[int, tuple[Tensor, Tensor]] = {}
        self._count = 0
        for tensor in inputs:
            self._reached_tensors[_storage(tensor)] = tensor

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run an operation: at once if no input reaches it, else as a part of the trace."""
        self._count += 1
        args, kwargs = tree_map_only(
            nn.Parameter, self._tensor_without_gradient, (args, kwargs or {})
        )
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        is_tensor_reached = any(_storage(tensor) in self._reached_tensors for tensor in tensors)
        if not is_tensor_reached and self._count not in self._known_written_tensors:
            self.computed += 1
            with disable_proxy_modes_tracing():
                result = func(*args, **kwargs)
            for tensor in _tensors(result):
                self._maker_by_storage.setdefault(_storage(tensor), (self._count, tensor))
                if tensor.nbytes >= _LARGE_TABLE_BYTES:
                    self.large_lines.setdefault(_storage(tensor), current_user_line())
            return result
        args = self._replace_masks_by_indices(func, args)
        if is_tensor_reached and _is_masked_write(func, args):
            result = _write_values_by_mask(func, args)
        elif is_tensor_reached and _is_one_of_each_row(func, args):
            result = _select_one_of_each_row(*args)
        else:
            if is_tensor_reached:
                _refuse_values(func, args)
            result = func(*_with_float_bounds(func, args), **kwargs)
        for tensor in (*_tensors(result), *_changed_tensors(func, args, kwargs)):
            key = _storage(tensor)
            if key in self._maker_by_storage and key not in self._reached_tensors:
                self.written.add(self._maker_by_storage[key][0])
            self._reached_tensors[key] = tensor
        return result

    def _replace_masks_by_indices(self, func: Any, args: Any) -> Any:
        """Replace constant masks by the indices of their true elements, whose number is known."""
        if func.overloadpacket not in _INDEX_OVERLOAD_PACKETS:
            return args
        indices: list[Tensor | None] = []
        for index in args[1]:
            if _is_mask(index) and _storage(index) not in self._reached_tensors:
                with disable_proxy_modes_tracing():
                    indices.extend(torch.nonzero(index, as_tuple=True))
            else:
                indices.append(index)
        return (args[0], indices, *args[2:])

    def _tensor_without_gradient(self, parameter: Tensor) -> Tensor:
        """Return a parameter's tensor, the same one each time: ``make_fx`` follows parameters."""
        if id(parameter) not in self._plain_tensors:
            with disable_proxy_modes_tracing():
                self._plain_tensors[id(parameter)] = parameter, parameter.detach()
        return self._plain_tensors[id(parameter)][1]


def _refuse_values(func: Any, args: Any) -> None:
    """Raise if an operation gives Python a value, or if a value decides the size of its result."""
    is_shape = torch.Tag.dynamic_output_shape in func.tags
    if (
        func.overloadpacket in _INDEX_OVERLOAD_PACKETS
    ):  # by numbers, the result has the size of the indices
        is_shape = any(map(_is_mask, args[1]))
    if is_shape or torch.Tag.data_dependent_output in func.tags:
        raise ValueNeeded(f"aten.{func.__name__}", current_user_line(), is_shape=is_shape)


def _is_masked_write(func: Any, args: Any) -> bool:
    """Return whether one value, or one row, is written where a mask is true: ``x[mask] = value``."""
    if func.overloadpacket not in _INDEX_OVERLOAD_PACKETS[1:] or not _is_mask(args[1][0]):
        return False
    target, (mask, *other_indices), value = args[:3]
    row_shape = target.shape[mask.ndim :]
    return not other_indices and (value.numel() == 1 or value.shape == row_shape)


def _write_values_by_mask(func: Any, args: Any) -> Tensor:
    """Write by ``torch.where``, whose result has the size of the target."""
    target, (mask,), value = args[:3]
    does_accumulate = len(args) > 3 and args[3]
    mask = mask.bool().reshape(*mask.shape, *[1] * (target.ndim - mask.ndim))
    value = value.reshape(()) if value.numel() == 1 else value
    result = torch.where(mask, target + value if does_accumulate else value, target)
    result = result.to(target.dtype)
    is_in_place = func.overloadpacket is torch.ops.aten.index_put_
    return target.copy_(result) if is_in_place else result


def _is_one_of_each_row(func: Any, args: Any) -> bool:
    """Return whether ``x[mask]`` selects one element of each row, as of ``one_hot``.

    That is so at the inputs of the trace; at others, the comparison with torch would tell.
    """
    if func is not torch.ops.aten.index.Tensor or len(args[1]) != 1 or not _is_mask(args[1][0]):
        return False
    (mask,) = args[1]
    with disable_proxy_modes_tracing():
        return mask.ndim == 2 and bool(mask.bool().sum(1).eq(1).all())


def _select_one_of_each_row(values: Tensor, indices: Sequence[Tensor]) -> Tensor:
    """Select by a sum of zeros and the selected element, whose size does not depend on the mask."""
    (mask,) = indices
    mask = mask.bool().reshape(*mask.shape, *[1] * (values.ndim - 2))
    return torch.where(mask, values, 0).sum(1, dtype=values.dtype)


def _with_float_bounds(func: Any, args: Any) -> Any:
    """Make the bounds of clamp floats if one of them is: the exporter knows no mixed ones."""
    if func not in _CLAMP_OPERATORS or not any(isinstance(bound, float) for bound in args[1:3]):
        return args
    return (args[0], *(bound if bound is None else float(bound) for bound in args[1:3]))


def _changed_tensors(func: Any, args: Any, kwargs: Any) -> Iterator[Tensor]:
    """Yield the arguments that an operation writes."""
    for number, argument in enumerate(func._schema.arguments):
        if argument.alias_info is not None and argument.alias_info.is_write:
            value = args[number] if number < len(args) else kwargs.get(argument.name)
            yield from _tensors(value)


def _tensors(values: Any) -> Iterator[Tensor]:
    return (leaf for leaf in tree_leaves(values) if isinstance(leaf, Tensor))


def _is_mask(index: Tensor | None) -> bool:
    return index is not None and index.dtype in (torch.bool, torch.uint8)


def _storage(tensor: Tensor) -> int:
    return int(tensor.untyped_storage()._cdata)


def _copy_tensors(tensors: Sequence[Tensor]) -> list[Tensor]:
    return [tensor.detach().clone() for tensor in tensors]


def _constants(graph: fx.GraphModule) -> Iterator[Tensor]:
    for node in graph.graph.nodes:
        if node.op == "get_attr":
            value = getattr(graph, node.target)
            if isinstance(value, Tensor):
                yield value


@contextmanager
def _restored_tensors(module: nn.Module) -> Iterator[None]:
    """Give buffers their values back that ``forward`` writes in place."""
    values = [(tensor, tensor.detach().clone()) for tensor in module.buffers()]
    try:
        yield
    finally:
        for tensor, value in values:
            tensor.copy_(value)

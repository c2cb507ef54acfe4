"""Finds the first operation of a torch module whose result differs between two equal runs."""

__all__ = ["Unrepeatable", "find_unrepeatable"]

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from gsgen.sdk.exporting.tracing.source_lines import current_user_line


@dataclass(frozen=True, slots=True)
class Unrepeatable:
    """An operation that gives another result, or gets another number, when forward runs again."""

    where: str  # ``file:line (code)`` of the user's code
    is_random: bool  # whether torch draws random numbers in it


def find_unrepeatable(module: nn.Module, inputs: Sequence[Tensor]) -> Unrepeatable | None:
    """Run a torch module twice at the same inputs, and return the first operation that differs.

    Random numbers of Python or numpy, clocks, files and state from earlier frames are found as
    well: an operation of torch gets another number, or another array, from them.
    """
    with torch.no_grad():
        with _RunDigest() as first_run:
            module(*(tensor.clone() for tensor in inputs))
        with _RunDigest(first_run.digests) as second_run:
            module(*(tensor.clone() for tensor in inputs))
    difference: Unrepeatable | None = second_run.difference
    return difference


class _RunDigest(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Records a digest of each operation, and compares it with that of an earlier run.

    Attributes:
        digests: The digests, in the order of the operations.
        difference: The first operation whose digest is not the expected one.
    """

    def __init__(self, expected: Sequence[bytes] = ()) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.digests: list[bytes] = []
        self.difference: Unrepeatable | None = None
        self._expected = expected

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run an operation, and compare it with the same operation of the earlier run."""
        result = func(*args, **(kwargs or {}))
        digest = _digest(func, (args, kwargs), result)
        number = len(self.digests)
        self.digests.append(digest)
        is_known = number < len(self._expected)
        if self.difference is None and is_known and digest != self._expected[number]:
            is_random = torch.Tag.nondeterministic_seeded in func.tags
            self.difference = Unrepeatable(current_user_line(), is_random)
        return result


def _digest(func: Any, arguments: Any, result: Any) -> bytes:
    """Return a digest of an operation's name, its numbers and its result."""
    numbers = [leaf for leaf in tree_leaves(arguments) if isinstance(leaf, int | float)]
    digest = hashlib.blake2b(f"{func} {numbers}".encode(), digest_size=16)
    # Memory that nothing has written yet differs from run to run.
    if not (func.is_view or "empty" in func.__name__):
        for leaf in tree_leaves(result):
            if isinstance(leaf, Tensor):
                digest.update(
                    leaf.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().data
                )
    return digest.digest()

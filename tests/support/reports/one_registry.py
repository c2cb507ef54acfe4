"""Exports of one test run share torch's table of operators.

Torch parses the source of all its operators anew for each export, half a second each time.
"""

__all__ = ["share_operators"]

from collections.abc import Callable
from functools import cache
from typing import Any

import pytest


def share_operators(patch: pytest.MonkeyPatch) -> None:
    """Let torch make its table of operators once for each operator set, and copy it from then on."""
    from torch.onnx._internal.exporter._registration import ONNXRegistry

    make: Callable[..., Any] = ONNXRegistry.from_torchlib
    made = cache(make)

    def from_torchlib(*options: Any, **named: Any) -> Any:
        kept, copied = made(*options, **named), ONNXRegistry()
        vars(copied).update(vars(kept))
        copied.functions = {target: list(known) for target, known in kept.functions.items()}
        return copied

    patch.setattr(ONNXRegistry, "from_torchlib", staticmethod(from_torchlib))

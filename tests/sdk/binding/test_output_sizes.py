"""Outputs that are too large to be allocated are refused, with the limit that they exceed."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gsgen.sdk.binding import RunFailed
from gsgen.sdk.binding.bound import bound_session
from gsgen.sdk.binding.bound.bound_session import _check_output_sizes

SPEC = cast(Any, SimpleNamespace(name="gaussians", dtype=np.dtype(np.float32)))


@pytest.mark.parametrize(
    ("host_bytes", "memory", "count", "words"),
    [
        (1 << 40, "gpu", (1 << 30) - 1, ""),
        (1 << 40, "gpu", 1 << 30, "4.3 GB, more than the largest buffer of WebGPU"),
        (1 << 40, "cpu", 1 << 30, ""),
        (4000, "gpu", 1000, ""),
        (4000, "cpu", 1001, "more than this machine's memory"),
    ],
)
def test_outputs_fit_buffers_and_memory(
    monkeypatch: pytest.MonkeyPatch, host_bytes: int, memory: str, count: int, words: str
) -> None:
    monkeypatch.setattr(bound_session, "host_bytes", lambda: host_bytes)
    shapes = {"gaussians": (count,)}
    if not words:
        _check_output_sizes((SPEC,), shapes, memory)
        return
    with pytest.raises(RunFailed, match=words) as caught:
        _check_output_sizes((SPEC,), shapes, memory)
    assert caught.value.where == "output gaussians"

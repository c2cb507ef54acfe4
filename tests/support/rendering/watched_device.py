"""What a frame asks of the graphics device."""

__all__ = ["watched"]

from typing import Any

import pytest

from gsgen.runtime.gpu.device import Device


class _Watched:
    """Stands before a wgpu device, and notes which objects it is asked to make."""

    def __init__(self, raw: Any, result: list[str]) -> None:
        self._raw = raw
        self._made = result

    def __getattr__(self, name: str) -> Any:
        if name.startswith("create_") and name != "create_command_encoder":  # one a frame
            self._made.append(name)
        return getattr(self._raw, name)


def watched(device: Device, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that grows with each object that a device is asked for from now on."""
    results: list[str] = []
    monkeypatch.setattr(device, "raw", _Watched(device.raw, results))
    return results

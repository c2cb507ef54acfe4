"""Errors of the runtime, each with a location and a hint for the user."""

__all__ = [
    "CapacityExceeded",
    "DeviceLost",
    "DeviceUnavailable",
    "DisplayUnavailable",
    "MemoryFull",
    "SceneInvalid",
    "SceneUnreadable",
    "locate_in_frame",
]

from gsgen.contract.errors import GsgenError


class DeviceUnavailable(GsgenError):
    """No graphics adapter exists, or it lacks a required feature."""


class DeviceLost(DeviceUnavailable):
    """The graphics device disappeared while drawing: its driver was reset, or it was removed."""


class DisplayUnavailable(GsgenError):
    """No window can be opened: there is no screen, or a package is not installed."""


class CapacityExceeded(GsgenError):
    """A scene or an image exceeds the largest buffer of the device."""


class MemoryFull(CapacityExceeded):
    """The device has too little free memory for a buffer that is within its limits."""


class SceneInvalid(GsgenError):
    """An invalid camera, transform or array raises the same error on every device."""


class SceneUnreadable(GsgenError):
    """A file holds no Gaussians or triangles that can be read (exit code 4)."""


def locate_in_frame(error: GsgenError, model: str, frame: int) -> GsgenError:
    """Return a copy of an error whose location also names the model and the frame."""
    frame_name = f"{model}, frame {frame}"
    where = frame_name if error.where in ("", model) else f"{frame_name}, {error.where}"
    return type(error)(error.message, where=where, hint=error.hint)

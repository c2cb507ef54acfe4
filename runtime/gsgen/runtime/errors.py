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
    """Raised if no graphics adapter exists, or if the adapter lacks a required feature."""


class DeviceLost(DeviceUnavailable):
    """Raised if the graphics device disappeared while drawing: reset by its driver, or removed."""


class DisplayUnavailable(GsgenError):
    """Raised if no window can be opened: there is no screen, or a package is not installed."""


class CapacityExceeded(GsgenError):
    """Raised if a scene or an image exceeds the largest buffer of the graphics device."""


class MemoryFull(CapacityExceeded):
    """Raised if the graphics device has too little free memory for a buffer of allowed size."""


class SceneInvalid(GsgenError):
    """Raised for an invalid camera, transform or array, on every graphics device alike."""


class SceneUnreadable(GsgenError):
    """Raised if a file holds no Gaussians or triangles that can be read (exit code 4)."""


def locate_in_frame(error: GsgenError, model: str, frame: int) -> GsgenError:
    """Return a copy of an error whose location also names the model and the frame."""
    frame_name = f"{model}, frame {frame}"
    where = frame_name if error.where in ("", model) else f"{frame_name}, {error.where}"
    return error.located(where)

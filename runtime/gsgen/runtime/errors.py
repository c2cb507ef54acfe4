"""What stops the runtime: errors that a user can meet, each with the next thing to do."""

__all__ = [
    "CapacityExceeded",
    "DeviceLost",
    "DeviceUnavailable",
    "DisplayUnavailable",
    "MemoryFull",
    "SceneInvalid",
    "SceneUnreadable",
    "placed",
]

from gsgen.contract.errors import GsgenError


class DeviceUnavailable(GsgenError):
    """There is no graphics adapter to draw with, or it refuses what is needed."""


class DeviceLost(DeviceUnavailable):
    """The device went away while it was drawn with: a driver was reset, or a GPU taken out."""


class DisplayUnavailable(GsgenError):
    """There is no screen to open a window on, or what opens one is not installed."""


class CapacityExceeded(GsgenError):
    """A scene or an image is larger than the device's buffers can be."""


class MemoryFull(CapacityExceeded):
    """The device has no memory left for a buffer that it could have otherwise."""


class SceneInvalid(GsgenError):
    """A camera, a transform or an array cannot be drawn, whatever the device."""


class SceneUnreadable(GsgenError):
    """A file holds no Gaussians that can be read (exit code 4)."""


def placed(error: GsgenError, model: str, frame: int) -> GsgenError:
    """Return an error that says in which model and frame it happened, too."""
    frame_name = f"{model}, frame {frame}"
    where = frame_name if error.where in ("", model) else f"{frame_name}, {error.where}"
    return type(error)(error.message, where=where, hint=error.hint)

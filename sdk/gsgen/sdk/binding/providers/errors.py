"""What can go wrong while a model runs every frame."""

__all__ = [
    "CaptureOff",
    "FellBack",
    "FrameGone",
    "InputInvalid",
    "NodesOnCpu",
    "ProviderUnavailable",
    "RunFailed",
    "SessionClosed",
    "SizeUnknown",
]

from gsgen.contract.errors import GsgenError


class SessionClosed(GsgenError):
    """A session, or a frame of it, was used after ``close``."""


class FrameGone(GsgenError):
    """A frame was read after the session had computed a newer one into the same buffers."""


class InputInvalid(GsgenError):
    """A value does not fit the input that it was given for."""


class SizeUnknown(GsgenError):
    """A symbolic dimension has no size, so that no buffer can be made for its tensor."""


class ProviderUnavailable(GsgenError):
    """The execution provider that was asked for cannot be had here."""


class FellBack(ProviderUnavailable):
    """ONNX Runtime opened a session without the provider that it was told to use."""


class RunFailed(GsgenError):
    """ONNX Runtime could not load or run the model."""


class CaptureOff(UserWarning):
    """Frames are not captured and replayed: the model or the provider does not allow it."""


class NodesOnCpu(UserWarning):
    """Some of the model's nodes run on the CPU though the session is on a GPU."""

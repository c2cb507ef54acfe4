"""Errors and warnings of sessions that run a model every frame."""

__all__ = [
    "CaptureOff", "FellBack", "FrameGone", "InputInvalid", "NodesOnCpu", "ProviderUnavailable",
    "RunFailed", "SessionClosed", "SizeUnknown",
]  # fmt: skip

from gsgen.contract.errors import GsgenError


class SessionClosed(GsgenError):
    """A session, or a frame of it, was used after ``close``."""


class FrameGone(GsgenError):
    """A frame was read after the session had computed a newer one into the same buffers."""


class InputInvalid(GsgenError):
    """A value does not fit its input in shape, dtype or range."""


class SizeUnknown(GsgenError):
    """A symbolic dimension has no size, so its tensor's buffer cannot be allocated."""


class ProviderUnavailable(GsgenError):
    """The requested execution provider is not available on this machine."""


class FellBack(ProviderUnavailable):
    """ONNX Runtime opened a session on another provider than the requested one."""


class RunFailed(GsgenError):
    """ONNX Runtime could not load or run the model."""


class CaptureOff(UserWarning):
    """Frames are not captured and replayed: the model or the provider does not allow it."""


class NodesOnCpu(UserWarning):
    """Some of the model's nodes run on the CPU although the session is on a GPU."""

"""Errors and warnings of ONNX Runtime sessions that run a model every frame."""

__all__ = [
    "CaptureOff",
    "FrameExpired",
    "InputInvalid",
    "NodesOnCpu",
    "ProviderFallback",
    "ProviderUnavailable",
    "RunFailed",
    "SessionClosed",
    "SizeUnknown",
]  # fmt: skip

from gsgen.contract.errors import GsgenError


class SessionClosed(GsgenError):
    """Raised if a model's session, or one of its frames, is used after ``close``."""


class FrameExpired(GsgenError):
    """Raised if a frame is read after a newer frame has overwritten its buffers."""


class InputInvalid(GsgenError):
    """Raised if a value does not fit a model input in shape, dtype or range."""


class SizeUnknown(GsgenError):
    """Raised if a symbolic dimension has no size, so that no buffer can be allocated."""


class ProviderUnavailable(GsgenError):
    """Raised if the requested execution provider is not available on this machine."""


class ProviderFallback(ProviderUnavailable):
    """Raised if ONNX Runtime opened a session on another execution provider than requested."""


class RunFailed(GsgenError):
    """Raised if ONNX Runtime could not load or run the model."""


class CaptureOff(UserWarning):
    """Warning that graph capture is off, because the model or the provider does not allow it."""


class NodesOnCpu(UserWarning):
    """Warning that some of a model's nodes run on the CPU, although its session is on a GPU."""

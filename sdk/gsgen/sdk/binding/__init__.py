"""Run a model every frame: one stable session, buffers bound once, inputs updated in place.

Needs numpy and ONNX Runtime, never torch. The names below are loaded when first used.
"""

from typing import TYPE_CHECKING

from gsgen.contract.lazy import attributes

if TYPE_CHECKING:
    from gsgen.sdk.binding.camera import CameraLike, Pinhole
    from gsgen.sdk.binding.errors import (
        CaptureOff,
        FrameGone,
        InputInvalid,
        NodesOnCpu,
        ProviderUnavailable,
        RunFailed,
        SessionClosed,
        SizeUnknown,
    )
    from gsgen.sdk.binding.frame import Frame
    from gsgen.sdk.binding.session import FrameSession
    from gsgen.sdk.binding.stop import Stop

__all__ = [
    "CameraLike",
    "CaptureOff",
    "Frame",
    "FrameGone",
    "FrameSession",
    "InputInvalid",
    "NodesOnCpu",
    "Pinhole",
    "ProviderUnavailable",
    "RunFailed",
    "SessionClosed",
    "SizeUnknown",
    "Stop",
]

_HOME = {
    "CameraLike": "camera",
    "CaptureOff": "errors",
    "Frame": "frame",
    "FrameGone": "errors",
    "FrameSession": "session",
    "InputInvalid": "errors",
    "NodesOnCpu": "errors",
    "Pinhole": "camera",
    "ProviderUnavailable": "errors",
    "RunFailed": "errors",
    "SessionClosed": "errors",
    "SizeUnknown": "errors",
    "Stop": "stop",
}

__getattr__ = attributes(__name__, _HOME)

"""How does a program run a model every frame, with buffers bound once and inputs updated in place?

Needs NumPy and ONNX Runtime, not torch. The names below are imported when first used.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr

if TYPE_CHECKING:
    from gsgen.sdk.binding.camera_inputs import CameraLike, Pinhole
    from gsgen.sdk.binding.frame import Frame
    from gsgen.sdk.binding.providers.cancellation import Stop
    from gsgen.sdk.binding.providers.errors import (
        CaptureOff,
        FrameGone,
        InputInvalid,
        NodesOnCpu,
        ProviderUnavailable,
        RunFailed,
        SessionClosed,
        SizeUnknown,
    )
    from gsgen.sdk.binding.session import FrameSession

__all__ = [
    "CameraLike", "CaptureOff", "Frame", "FrameGone", "FrameSession", "InputInvalid", "NodesOnCpu",
    "Pinhole", "ProviderUnavailable", "RunFailed", "SessionClosed", "SizeUnknown", "Stop",
]  # fmt: skip

__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)

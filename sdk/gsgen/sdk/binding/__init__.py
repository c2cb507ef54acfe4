"""How does a program run a model every frame, with buffers bound once and inputs updated in place?

Needs NumPy and ONNX Runtime, not torch. The names below are imported when first used.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

if TYPE_CHECKING:
    from gsgen.contract.process.limits import Limits
    from gsgen.sdk.binding.camera_inputs import CameraLike, Pinhole
    from gsgen.sdk.binding.confined.models import ConfinedModels
    from gsgen.sdk.binding.frame import Frame
    from gsgen.sdk.binding.providers.cancellation import Stop
    from gsgen.sdk.binding.providers.errors import (
        CaptureOff,
        FrameExpired,
        InputInvalid,
        NodesOnCpu,
        ProviderUnavailable,
        RunFailed,
        SessionClosed,
        SizeUnknown,
    )
    from gsgen.sdk.binding.session import FrameSession

__all__ = [
    "CameraLike", "CaptureOff", "ConfinedModels", "Frame", "FrameExpired", "FrameSession",
    "InputInvalid", "Limits", "NodesOnCpu",
    "Pinhole", "ProviderUnavailable", "RunFailed", "SessionClosed", "SizeUnknown", "Stop",
]  # fmt: skip

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "CameraLike": "gsgen.sdk.binding.camera_inputs",
    "Pinhole": "gsgen.sdk.binding.camera_inputs",
    "ConfinedModels": "gsgen.sdk.binding.confined.models",
    "Frame": "gsgen.sdk.binding.frame",
    "Stop": "gsgen.sdk.binding.providers.cancellation",
    "CaptureOff": "gsgen.sdk.binding.providers.errors",
    "FrameExpired": "gsgen.sdk.binding.providers.errors",
    "Limits": "gsgen.contract.process.limits",
    "InputInvalid": "gsgen.sdk.binding.providers.errors",
    "NodesOnCpu": "gsgen.sdk.binding.providers.errors",
    "ProviderUnavailable": "gsgen.sdk.binding.providers.errors",
    "RunFailed": "gsgen.sdk.binding.providers.errors",
    "SessionClosed": "gsgen.sdk.binding.providers.errors",
    "SizeUnknown": "gsgen.sdk.binding.providers.errors",
    "FrameSession": "gsgen.sdk.binding.session",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)

"""Finds the device of ONNX Runtime's WebGPU provider.

The provider is a plug-in (onnxruntime-ep-webgpu) that a process registers once.
"""

__all__ = ["DRIVER_HINT", "PACKAGE", "WEBGPU", "Adapter", "AdapterMissing", "find_adapter"]

import os
import threading
from dataclasses import dataclass
from typing import Any

WEBGPU = "WebGpuExecutionProvider"
PACKAGE = "onnxruntime_ep_webgpu"
DRIVER_HINT = "install a Vulkan driver, such as mesa-vulkan-drivers 25"
_SOFTWARE_VARIABLE = "ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER"

# A unique name: registering a name twice kills the process at the next session, and a name that
# ends in ".virtual" aborts it at once.
_REGISTRATION_NAME = "gsgen.webgpu"
_registration_lock = threading.Lock()
_is_plugin_registered = False


class AdapterMissing(Exception):
    """Raised if ONNX Runtime's WebGPU provider or a device for it is missing.

    Attributes:
        message: The missing part.
        hint: How to install it.
    """

    def __init__(self, message: str, hint: str) -> None:
        self.message, self.hint = message, hint
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Adapter:
    """A GPU that ONNX Runtime's WebGPU provider can open."""

    device: Any  # ONNX Runtime's handle
    name: str  # the driver's name for the device; may be empty
    version: str  # version of the provider
    hardware: bool  # whether it is a GPU, not a software driver


def find_adapter() -> Adapter:
    """Return the best GPU for ONNX Runtime's WebGPU provider; register the provider first.

    Software drivers are allowed unless the environment variable
    ``ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER`` is 0 before the first call.
    """
    import onnxruntime

    try:
        import onnxruntime_ep_webgpu as provider
    except ImportError as error:
        message = "onnxruntime-ep-webgpu is not installed"
        raise AdapterMissing(message, "pip install 'gsgen[live]'") from error
    if not hasattr(onnxruntime, "register_execution_provider_library"):
        message = f"onnxruntime {onnxruntime.__version__} does not support plug-in providers"
        raise AdapterMissing(message, "pip install -U onnxruntime")
    _register_webgpu_plugin(provider.get_library_path())
    name = provider.get_ep_name()
    devices = [candidate for candidate in onnxruntime.get_ep_devices() if candidate.ep_name == name]
    if not devices:
        message = "ONNX Runtime lists no device for WebGPU"
        raise AdapterMissing(message, DRIVER_HINT)
    gpu = onnxruntime.OrtHardwareDeviceType.GPU
    device = min(devices, key=lambda candidate: candidate.device.type != gpu)
    return Adapter(
        device=device,
        name=device.device.metadata.get("Description", device.device.vendor),
        version=device.ep_metadata.get("version", ""),
        hardware=device.device.type == gpu,
    )


def _register_webgpu_plugin(library: str) -> None:
    global _is_plugin_registered
    import onnxruntime

    with _registration_lock:
        if not _is_plugin_registered:
            os.environ.setdefault(_SOFTWARE_VARIABLE, "1")
            onnxruntime.register_execution_provider_library(_REGISTRATION_NAME, library)
            _is_plugin_registered = True

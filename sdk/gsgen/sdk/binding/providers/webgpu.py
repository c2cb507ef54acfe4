"""ONNX Runtime's WebGPU provider: find its device, and know where nodes went.

It is a plug-in (onnxruntime-ep-webgpu) that a process registers once.
"""

__all__ = ["DRIVER", "PACKAGE", "WEBGPU", "Adapter", "AdapterMissing", "find_adapter"]

import os
import threading
from dataclasses import dataclass
from typing import Any

WEBGPU = "WebGpuExecutionProvider"
PACKAGE = "onnxruntime_ep_webgpu"
DRIVER = "install a Vulkan driver, such as mesa-vulkan-drivers 25"
_SOFTWARE = "ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER"

# A name of our own: a name that is registered twice kills the process at the next session, and
# one that ends in ".virtual" aborts it at once.
_NAME = "gsgen.webgpu"
_registering = threading.Lock()
_registered = False


class AdapterMissing(Exception):
    """The provider or a device for it is missing here, which is no fault of any model.

    Attributes:
        message: What is missing.
        hint: What to type to install it.
    """

    def __init__(self, message: str, hint: str) -> None:
        self.message, self.hint = message, hint
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Adapter:
    """A device that the provider can open.

    Attributes:
        device: ONNX Runtime's handle.
        name: What its driver calls it; may be empty.
        version: Version of the provider.
        hardware: It is a GPU, not a driver that computes on the CPU.
    """

    device: Any
    name: str
    version: str
    hardware: bool


def find_adapter() -> Adapter:
    """Return the best device of the provider, registering the provider at the first call.

    Software drivers are welcome unless the environment says
    ``ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER=0`` before the first call.

    Raises:
        AdapterMissing: The package or a driver is missing, or ONNX Runtime is too old.
    """
    import onnxruntime

    try:
        import onnxruntime_ep_webgpu as provider
    except ImportError as error:
        what = "onnxruntime-ep-webgpu is not installed"
        raise AdapterMissing(what, "pip install 'gsgen[live]'") from error
    if not hasattr(onnxruntime, "register_execution_provider_library"):
        what = f"onnxruntime {onnxruntime.__version__} takes no plug-in providers"
        raise AdapterMissing(what, "pip install -U onnxruntime")
    _register(provider.get_library_path())
    name = provider.get_ep_name()
    devices = [one for one in onnxruntime.get_ep_devices() if one.ep_name == name]
    if not devices:
        what = "ONNX Runtime lists no device for WebGPU"
        raise AdapterMissing(what, DRIVER)
    gpu = onnxruntime.OrtHardwareDeviceType.GPU
    device = min(devices, key=lambda one: one.device.type != gpu)
    return Adapter(
        device=device,
        name=device.device.metadata.get("Description", device.device.vendor),
        version=device.ep_metadata.get("version", ""),
        hardware=device.device.type == gpu,
    )


def _register(library: str) -> None:
    global _registered
    import onnxruntime

    with _registering:
        if not _registered:
            os.environ.setdefault(_SOFTWARE, "1")
            onnxruntime.register_execution_provider_library(_NAME, library)
            _registered = True

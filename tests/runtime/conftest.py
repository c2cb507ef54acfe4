import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer


@pytest.fixture(scope="session")
def device() -> Device:
    return Device.open()


@pytest.fixture(scope="session")
def renderer(device: Device) -> Renderer:
    """One for all tests: kernels are compiled once."""
    return Renderer(device, rasteriser="tiles")

import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer
from support.rendering.small_bindings import whole_and_small


@pytest.fixture(scope="module", params=["as it is", "as a GPU"])
def renderers(device: Device, request: pytest.FixtureRequest) -> tuple[Renderer, Renderer]:
    """Two renderers of a device, the second of which binds little."""
    return whole_and_small(device, as_gpu=request.param == "as a GPU")

"""The kernel that copies another renderer's picture to an image layer, beside its twin."""

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.kernel import Step, run
from gsgen.runtime.kernels.shared.shader import NOWHERE, TILE
from references.layers import import_reference
from web_client.browser_kernels import PICTURE, ImportLayer


@pytest.mark.parametrize(("width", "height"), [(1, 1), (17, 5), (33, 40)])
@pytest.mark.parametrize(
    ("is_reversed", "is_encoded"), [(False, False), (True, False), (False, True)]
)
def test_a_layer_is_a_picture_with_depths(
    device: Device, width: int, height: int, is_reversed: bool, is_encoded: bool
) -> None:
    """Of both kinds of depth buffer, with padded rows, empty pixels and a background."""
    rng = np.random.default_rng(width)
    near, far, layer = 0.1, 50.0, 1
    depth = rng.uniform(near, far, (height, width + 3)).astype(np.float32)
    # value = (n f / z − n or f) / (n − f or f − n): 0 and 1 at the planes, as WebGPU has them.
    slope, offset = (near, near * far) if is_reversed else (-far, -near * far)
    slope, offset = slope / (far - near), offset / (far - near)
    values = (offset / depth.astype(np.float64) - slope).astype(np.float32)
    empty = np.float32(not is_reversed)
    values[rng.random(values.shape) < 0.2] = empty
    alpha = rng.choice([0, 0.25, 1], (height, width + 5, 1))
    halves = np.concatenate([alpha * rng.random((*alpha.shape[:2], 3)), alpha], -1)
    halves = halves.astype(np.float16)
    picture = np.array(
        (
            *((width, height), width + 5, width + 3, layer * width * height),
            *(empty, slope, offset, is_encoded),
        ),
        PICTURE,
    )
    pixels = width * height
    uniform = device.uniform("picture", PICTURE.itemsize)
    names = {
        "halves": halves.nbytes,
        "values": values.nbytes,
        "layers": 32 * pixels,
        "depths": 8 * pixels,
    }
    buffers = {name: device.storage(name, size) for name, size in names.items()}
    device.write(uniform, picture.reshape(1))
    device.write(buffers["halves"], halves)
    device.write(buffers["values"], values)
    kernel = ImportLayer(device).kernel
    binds = (
        kernel.bind(uniform, buffers["halves"], buffers["values"], buffers["layers"]),
        kernel.bind(buffers["depths"], group=1),
    )
    encoder = device.raw.create_command_encoder()
    run(encoder, [Step(kernel, binds, (-(-width // TILE), -(-height // TILE), 1))], "test")
    device.submit(encoder)
    colors = device.read(buffers["layers"], np.float32, 8 * pixels).reshape(2, height, width, 4)
    depths = device.read(buffers["depths"], np.float32, 2 * pixels).reshape(2, height, width)
    expected_colors, expected_depths = import_reference(picture, halves, values)
    np.testing.assert_allclose(colors[layer], expected_colors, atol=2e-4)
    np.testing.assert_allclose(depths[layer], expected_depths, rtol=1e-5)
    assert not colors[0].any()
    visible_mask = (halves[:, :width, 3] > 0) & (values[:, :width] != empty)
    np.testing.assert_allclose(
        depths[layer][visible_mask], depth[:, :width][visible_mask], rtol=2e-3
    )
    assert (depths[layer][halves[:, :width, 3] == 0] == np.float32(NOWHERE)).all()

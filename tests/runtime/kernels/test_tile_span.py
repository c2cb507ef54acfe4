"""Tiles of pixels: the integers that `tile_span.wgsl` reads from the bits of a float."""

import numpy as np
import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.shader import LARGE_TILE, TILE, source

TILE_SHADER = """
@group(0) @binding(1) var<storage, read_write> pixels: array<f32>;
@compute @workgroup_size(1)
fn each(@builtin(global_invocation_id) invocation: vec3u) {
    let index = invocation.x;
    pixels[index] = bitcast<f32>(tile_at(pixels[index], LIMIT));
}
"""


@pytest.mark.parametrize("tile", [TILE, LARGE_TILE])
@pytest.mark.parametrize("limit", [0, 1, 40, 65_535])
def test_tile_of_a_pixel_agrees_with_float_rounding(tile: int, limit: int) -> None:
    borders = tile * np.arange(-2, 70, dtype=np.float32)
    pixels = np.concatenate(
        [
            borders,
            np.nextafter(borders, np.float32(-np.inf)),
            np.nextafter(borders, np.float32(np.inf)),
            np.float32([-0.0, 1e6, 2.0**23, 2.0**24 + 2, 3e9, 1e30, -1e30, np.inf, -np.inf]),
            np.float32([1e-40, -1e-40, 1e-30, np.nan]),
        ]
    )
    device = Device.open()
    raw = device.raw
    code = source("tile_span", TILE=tile, LIMIT=limit) + TILE_SHADER
    module = raw.create_shader_module(label="each", code=code)
    pipeline = raw.create_compute_pipeline(
        layout="auto", compute={"module": module, "entry_point": "each"}
    )
    numbers = device.storage("pixels", 4 * len(pixels))
    device.write(numbers, pixels)
    bind = raw.create_bind_group(
        layout=pipeline.get_bind_group_layout(0),
        entries=[
            {"binding": 1, "resource": {"buffer": numbers, "offset": 0, "size": numbers.size}}
        ],
    )
    encoder = raw.create_command_encoder()
    compute = encoder.begin_compute_pass()
    compute.set_pipeline(pipeline)
    compute.set_bind_group(0, bind)
    compute.dispatch_workgroups(len(pixels))
    compute.end()
    device.submit(encoder)
    tiles = device.read(numbers, np.uint32, len(pixels))
    tile_index = np.floor(
        np.nan_to_num(pixels.astype(np.float64), posinf=np.inf, neginf=-np.inf) / tile
    )
    expected = np.clip(tile_index, 0, limit)
    np.testing.assert_array_equal(tiles, expected)

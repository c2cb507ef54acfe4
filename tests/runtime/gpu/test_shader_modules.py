"""Shader modules are compiled without counters of loops; errors in WGSL are still raised."""

from types import SimpleNamespace

import numpy as np
import pytest

from gsgen.runtime.gpu import shader_modules
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.shader_modules import create_shader_module

wgpu = pytest.importorskip("wgpu")

SUM = """
@group(0) @binding(0) var<storage, read_write> numbers: array<u32>;
@compute @workgroup_size(1)
fn add() {
    var sum = 0u;
    for (var i = 0u; i < numbers[0]; i++) {
        sum += i;
    }
    numbers[0] = sum;
}
"""


def result(device: Device, code: str) -> int:
    """Run a shader on the number 100, and return what it writes."""
    raw = device.raw
    module = create_shader_module(raw, "a shader named Σ", code)
    pipeline = raw.create_compute_pipeline(
        layout="auto", compute={"module": module, "entry_point": "add"}
    )
    numbers = device.storage("numbers", 16)
    device.write(numbers, np.array([100], np.uint32))
    bind = raw.create_bind_group(
        layout=pipeline.get_bind_group_layout(0),
        entries=[{"binding": 0, "resource": {"buffer": numbers, "offset": 0, "size": 16}}],
    )
    encoder = raw.create_command_encoder()
    compute = encoder.begin_compute_pass()
    compute.set_pipeline(pipeline)
    compute.set_bind_group(0, bind)
    compute.dispatch_workgroups(1)
    compute.end()
    device.submit(encoder)
    return int(device.read(numbers, np.uint32, 1)[0])


@pytest.fixture(params=["chosen checks", "all checks"])
def device(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Device:
    if request.param == "all checks":
        monkeypatch.setattr(shader_modules, "_native_function", lambda: None)
    return Device.open()


def test_a_shader_runs(device: Device) -> None:
    assert result(device, SUM) == 4950


def test_an_error_is_raised_where_the_shader_is_compiled(device: Device) -> None:
    with pytest.raises(wgpu.GPUValidationError, match="no definition in scope"):
        create_shader_module(device.raw, "wrong", SUM.replace("sum += i", "sum += j"))


def test_loops_alone_are_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    device, checks = Device.open(), list[int]()
    native = shader_modules._native_function()
    assert native is not None

    def create(raw: object, descriptor: object, chosen: int) -> object:
        checks.append(chosen)
        return native(raw, descriptor, chosen)

    monkeypatch.setattr(shader_modules, "_native_function", lambda: create)
    assert result(device, SUM) == 4950
    from wgpu.backends.wgpu_native import lib

    loops = lib.WGPUShaderRuntimeChecks_ForceLoopBounding
    bounds = lib.WGPUShaderRuntimeChecks_BoundsChecks
    assert [chosen & loops for chosen in checks] == [0]
    assert [chosen & bounds for chosen in checks] == [bounds]


def test_other_devices_compile_by_themselves() -> None:
    recorded = SimpleNamespace(create_shader_module=lambda **given: given)
    assert create_shader_module(recorded, "sum", SUM) == {"label": "sum", "code": SUM}

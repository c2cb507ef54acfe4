"""Private names of wgpu stand in one module, whose functions can do without them."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gsgen.runtime
from gsgen.runtime.gpu import native
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.native import create_shader_module, parse_native_types, timestamp_period
from gsgen.runtime.gpu.readback import StagingBuffers
from support.commands import ROOT

wgpu = pytest.importorskip("wgpu")

SUM_SHADER = """
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

_FIRST_PICTURE = """
import json
import numpy as np
from wgpu.backends.wgpu_native import ffi
from gsgen.runtime import Camera, Renderer, Scene, SplatData
from gsgen.runtime.gpu.native import parse_native_types

parse_native_types()
before = set(ffi._parsed_types)
rows = np.zeros((1, 10), np.float32)
rows[:, 3:5] = rows[:, [7, 9]] = 0.5
data = SplatData(rows, np.zeros((1, 3), np.float32), "rgb")
Renderer().render(Scene([data]), Camera.orbit((0, 0, 0), 4, width=16, height=16))
print(json.dumps(sorted(set(ffi._parsed_types) - before)))
"""

_PRIVATE = re.compile(
    r"\b(?:_internal|_parsed_types|_ffi|_api|libf|READ_NOSYNC)\b|from wgpu\.backends|import wgpu\.backends"
    r"|\braw\._|\b(?:queue|encoder|buffer|texture|adapter)\._[a-z]"
)


def test_no_other_module_uses_private_names_of_wgpu() -> None:
    """Catches a new call that the next release of wgpu may take away."""
    folder = Path(next(iter(gsgen.runtime.__path__))).parent
    uses = [
        f"{path.relative_to(folder)}:{number}: {line.strip()}"
        for path in sorted(folder.rglob("*.py"))
        if path != Path(native.__file__)
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        if _PRIVATE.search(line)
    ]
    assert uses == []
    assert _PRIVATE.search(Path(native.__file__).read_text("utf-8"))


def test_range_of_wgpu_ends_before_versions_that_were_not_tested() -> None:
    """Catches a range without an end: the next release may rename what the module takes."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    needs = [
        requirement
        for requirement in project["optional-dependencies"]["runtime"]
        if "wgpu" in requirement
    ]
    assert len(needs) == 1
    assert re.fullmatch(r"wgpu>=[\d.]+,<[\d.]+", needs[0])


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
        monkeypatch.setattr(native, "_load_function", lambda name: None)
    return Device.open()


def test_shader_compiles_and_runs(device: Device) -> None:
    assert result(device, SUM_SHADER) == 4950


def test_wgsl_error_is_raised_where_the_shader_is_compiled(device: Device) -> None:
    with pytest.raises(wgpu.GPUValidationError, match="no definition in scope"):
        create_shader_module(device.raw, "wrong", SUM_SHADER.replace("sum += i", "sum += j"))


def test_shader_keeps_all_checks_but_that_of_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    device, checks = Device.open(), list[int]()
    function = native._load_function(native._CREATE_FUNCTION)
    assert function is not None

    def create(raw: object, descriptor: object, chosen: int) -> object:
        checks.append(chosen)
        return function(raw, descriptor, chosen)

    monkeypatch.setattr(native, "_load_function", lambda name: create)
    assert result(device, SUM_SHADER) == 4950
    from wgpu.backends.wgpu_native import lib

    loops = lib.WGPUShaderRuntimeChecks_ForceLoopBounding
    bounds = lib.WGPUShaderRuntimeChecks_BoundsChecks
    assert [chosen & loops for chosen in checks] == [0]
    assert [chosen & bounds for chosen in checks] == [bounds]


def test_device_that_records_compiles_by_itself() -> None:
    recorded = SimpleNamespace(create_shader_module=lambda **descriptor: descriptor)
    assert create_shader_module(recorded, "sum", SUM_SHADER) == {"label": "sum", "code": SUM_SHADER}


def test_timestamp_period_is_positive_and_one_without_wgpus_function(device: Device) -> None:
    assert timestamp_period(device.raw) > 0
    assert timestamp_period(SimpleNamespace(queue=object())) == 1.0


@pytest.mark.parametrize("mode", ["READ_NOSYNC", "a mode that wgpu does not know"])
def test_staging_reads_what_was_submitted(monkeypatch: pytest.MonkeyPatch, mode: str) -> None:
    monkeypatch.setattr(native, "_READ_MODE", mode)
    device = Device.open()
    numbers = device.storage("numbers", 16)
    staging = StagingBuffers(device, {"numbers": numbers})
    for first in (0, 4):
        device.write(numbers, np.arange(first, first + 4, dtype=np.uint32))
        encoder = device.raw.create_command_encoder()
        staging.encode(encoder)
        device.submit(encoder)
        staging.begin()
        assert staging.read_words()["numbers"].tolist() == list(range(first, first + 4))


def test_staging_that_was_not_read_is_used_again() -> None:
    """Catches a buffer that an interrupt left mapped."""
    device = Device.open()
    numbers = device.storage("numbers", 16)
    staging = StagingBuffers(device, {"numbers": numbers})
    for number in (1, 2):
        device.write(numbers, np.full(4, number, np.uint32))
        encoder = device.raw.create_command_encoder()
        staging.encode(encoder)
        device.submit(encoder)
        staging.begin()
    assert staging.read_words()["numbers"].tolist() == [2] * 4


def test_pointers_to_all_types_are_known_without_parsing() -> None:
    from wgpu.backends.wgpu_native import ffi

    names = ffi.list_types()[0]
    assert parse_native_types() >= 400
    assert {f"{name} *" for name in names} <= set(ffi._parsed_types)
    assert ffi.sizeof(ffi.new("WGPULimits *")[0]) > 100
    for name in np.random.default_rng(7).choice(sorted(names), 5, replace=False):
        assert ffi.typeof(f"{name} *").item is ffi.typeof(str(name)), name


def test_first_picture_parses_no_type() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", _FIRST_PICTURE], capture_output=True, encoding="utf-8", timeout=120
    )
    assert completed.returncode == 0, completed.stderr
    assert json.loads(completed.stdout.splitlines()[-1]) == []


def test_types_that_are_parsed_together_are_those_that_cffi_parses() -> None:
    from wgpu.backends.wgpu_native import ffi

    parse_native_types()
    for text in (*native._PLAIN_TYPES, *native._ARRAY_TYPES, *native._CALLBACK_TYPES):
        retained, is_function = ffi._parsed_types.pop(text)
        if is_function:
            assert ffi._typeof(text, consider_function_as_funcptr=True) is retained
        else:
            assert ffi.typeof(text) is retained


def test_types_are_parsed_singly_where_cffi_keeps_them_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(native, "_parsed_types", lambda: None)
    assert parse_native_types.__wrapped__() == 0

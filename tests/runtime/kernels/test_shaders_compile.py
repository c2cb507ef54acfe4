"""Every shader file is whole: it compiles by itself, included or not."""

import re
from importlib.resources import files

import pytest

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.project.project import NO_HARMONICS, SPLAT_RADIUS_SIGMAS
from gsgen.runtime.kernels.project.project_cells import CELL_RADIUS_SIGMAS
from gsgen.runtime.kernels.raster.draw_meshes import AMBIENT_LIGHT
from gsgen.runtime.kernels.shared.counts import COUNT_CONSTANTS
from gsgen.runtime.kernels.shared.shader import source
from gsgen.runtime.kernels.sort.order_ties import MAX_TIED_KEYS
from gsgen.runtime.kernels.tiles.blend_tiles import MIN_TRANSMITTANCE
from gsgen.runtime.kernels.tiles.blend_wsr import MIN_WSR_TRANSMITTANCE

SHADERS = {
    file.name.removesuffix(".wgsl"): file.read_text("utf-8")
    for room in files("gsgen.runtime.kernels").iterdir()
    if room.is_dir()
    for file in room.iterdir()
    if file.name.endswith(".wgsl")
}
CONSTANTS: dict[str, int | float | bool] = {
    **COUNT_CONSTANTS,
    "THREADS": 8,
    "RUN": 4,
    "RUNS": 8,
    "LISTS": True,
    "BLOCK": 32,
    "SHARE": 1,
    "DIGITS": 16,
    "SORT_BLOCK": 32,
    "WALK_BLOCK": 32,
    "RANGE_BLOCK": 32,
    "MOST_TIED": MAX_TIED_KEYS,
    "ARRANGED": True,
    "HALF_APPEARANCE": True,
    "STRIDE": 2,
    "NO_HARMONICS": NO_HARMONICS,
    "WEIGHTED": False,
    "COLUMNS": 2,
    "QUADS": 4,
    "CELLS": 8,
    "PARTS": 8,
    "LANES": 8,
    "CELL_WIDTH": 8,
    "CELL_HEIGHT": 4,
    "POLYNOMIAL": True,
    "PICK": False,
    "MASKED": True,
    "PUBLISHED": False,
    "FIRST_PLANE": 0,
    "KEPT": 8,
    "SPLAT_REACH": SPLAT_RADIUS_SIGMAS,
    "CELL_REACH": CELL_RADIUS_SIGMAS,
    "MIN_TRANSMITTANCE": MIN_TRANSMITTANCE,
    "FINISHED": MIN_WSR_TRANSMITTANCE,
    "KEYS_ONLY": False,
    "PLACED": False,
    "RECORDS": False,
    "CARRIED": False,
    "CARRIED_OUTPUT": 0,
    "STEEP": False,
    "WINDOWS": False,
    "LAYERED": True,
    "LAYERS": 2,
    "TESTED": True,
    "CORNERS": 3,
    "AMBIENT": AMBIENT_LIGHT,
    "SLOT_ROWS": 128,
    "PAGE_SLOTS": 64,
    "PAGE_ROWS": 512,
    "PAGE_STEP": 64,
    "WORDS": 4,
    "HALF": True,
    "HALF_SOURCE": True,
    "HALF_TARGET": True,
    "CULL_MARGIN": 0.15,
    "REACH": 3.5,
    "MODE_DEPTH": 1,
    "MODE_MEDIAN": 2,
    "MODE_NORMAL": 3,
    "MODE_ALPHA": 4,
}
VARIANTS: dict[str, dict[str, int | float | bool]] = {
    "usual": {},
    "panorama": {"PANORAMA": True, "CORNERS": 6},
    "distorted": {"DISTORTED": True},
    "fisheye": {"FISHEYE": True},
    "other branches": {
        "LAYERS": 0,
        "LAYERED": False,
        "PICK": True,
        "KEPT": 10,
        "WEIGHTED": True,
        "PACKED": True,
        "POLYNOMIAL": False,
        "ARRANGED": False,
        "KEYS_ONLY": True,
        "PLACED": True,
        "CARRIED": True,
        "STEEP": True,
        "MASKED": False,
        "HALF": False,
        "HALF_APPEARANCE": False,
        "HALF_TARGET": False,
        "LISTS": False,
        "WINDOWS": True,
    },
    "64 bits at a time": {"wide_words": True},
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", sorted(SHADERS))
def test_a_shader_compiles_by_itself(device: Device, name: str, variant: str) -> None:
    """wgpu raises for a name that neither the file nor its includes declare."""
    if "subgroup" in SHADERS[name] and not device.subgroups:
        pytest.skip("the device has no subgroups")
    if ("u64" in SHADERS[name] or "wide_words" in VARIANTS[variant]) and not device.has_int64:
        pytest.skip("the device reads no 64 bits at a time")
    declared = set(re.findall(r"^const (\w+)", SHADERS[name], re.MULTILINE))
    constants = {
        key: value for key, value in (CONSTANTS | VARIANTS[variant]).items() if key not in declared
    }
    device.raw.create_shader_module(label=name, code=source(name, **constants))


def test_incomplete_shader_does_not_compile(device: Device) -> None:
    import wgpu

    code = source("scan_sums", THREADS=8).replace("var<workgroup> sums", "// ")
    with pytest.raises(wgpu.GPUError, match="sums"):
        device.raw.create_shader_module(code=code)


@pytest.mark.parametrize("name", sorted(SHADERS))
def test_a_shader_opens_with_its_subject_and_then_its_includes(name: str) -> None:
    """Includes stand above all code, and every one names a file."""
    assert SHADERS[name].startswith("// ")
    code = re.search(r"^(?!//|\n|$).", SHADERS[name], re.MULTILINE)
    assert code is not None
    includes = list(re.finditer(r"^//!include (\w+)$", SHADERS[name], re.MULTILINE))
    assert all(include.start() < code.start() for include in includes)
    assert {include[1] for include in includes} <= set(SHADERS)

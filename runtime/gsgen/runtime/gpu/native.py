"""All that the runtime takes from wgpu besides its public API; each part can do without it.

Four things are worth private names of wgpu-py, of its library wgpu-native and of cffi:

1. ``parse_native_types``. wgpu names the type of each structure, array and callback that it makes,
   as in ``ffi.new("WGPULimits *")``. cffi parses a name that is new to it behind declarations of
   all typedefs that it knows: 13 ms for each of the 60 types that a first picture needs. All
   together take 80 ms. Without it, each is parsed when it is first needed.
2. ``create_shader_module``. wgpu ends every loop after 2⁶⁴ turns, by two words that each turn
   decrements and tests: 4 % of a frame on a CPU. Kernels loop over ranges, so that they need no
   such test. Without it, shaders are compiled with all of wgpu's checks.
3. ``timestamp_period``. wgpu-py does not tell how long a tick of the GPU's clock is. Without it,
   ticks count as nanoseconds, which they are on most devices.
4. ``map_for_reading``. wgpu-py submits an empty command buffer before it maps one for reading, and
   drivers may wait for the frame before they take it, so that no frame would be in flight. It
   reads whole buffers in an internal mode without that. Without the mode, it submits.

The versions of wgpu with which all of this was tested are the range in ``pyproject.toml``.
"""

__all__ = ["create_shader_module", "map_for_reading", "parse_native_types", "timestamp_period"]

import re
from functools import cache
from typing import Any, Final

from gsgen.runtime.gpu.handles import Buffer, Promise, RawDevice, ShaderModule

_NATIVE_TYPES_STRUCT: Final = "struct gsgen_native_types"

# Types besides pointers to structures, as wgpu spells them. Each is a key of cffi's table, so spaces
# count; one that a version of wgpu spells otherwise is parsed when it is needed.
_PLAIN_TYPES: Final = ("intptr_t", "uintptr_t", "uint8_t *", "uint32_t *", "WGPUChainedStruct * ")
_ARRAY_TYPES: Final = (
    *("char []", "char[]", "uint8_t []", "uint8_t[]", "uint32_t []"),
    *("WGPUBindGroupEntry[]", "WGPUBindGroupLayout[]", "WGPUBindGroupLayoutEntry[]"),
    *("WGPUColorTargetState[]", "WGPUCommandBuffer[]", "WGPUConstantEntry[]", "WGPUFeatureName[]"),
    *("WGPURenderPassColorAttachment[]", "WGPUTextureFormat[]"),
    *("WGPUVertexAttribute[]", "WGPUVertexBufferLayout[]"),
)
_CALLBACK_TYPES: Final = (
    "void(WGPURequestAdapterStatus, WGPUAdapter, WGPUStringView, void *, void *)",
    "void(WGPURequestDeviceStatus, WGPUDevice, WGPUStringView, void *, void *)",
    "void(WGPUDevice const *, WGPUDeviceLostReason, WGPUStringView, void *, void *)",
    "void(WGPUDevice const *, WGPUErrorType, WGPUStringView, void *, void *)",
    "void(WGPUMapAsyncStatus, WGPUStringView, void *, void *)",
    "void(WGPUQueueWorkDoneStatus, void *, void *)",
)


@cache
def parse_native_types() -> int:
    """Parse the C types that wgpu's native library and its Python module use, once a process.

    Returns:
        How many types cffi then finds without parsing: 0 with a version of wgpu or cffi that keeps
        them elsewhere, and that parses each when it is first needed.
    """
    from wgpu.backends.wgpu_native import ffi

    parsed_types = _parsed_types()
    if parsed_types is None:
        return 0
    names = ffi.list_types()[0]
    members = {f"{name} *": f"{name} *{{}}" for name in names}
    members |= {text: f"{text}{{}}" for text in _PLAIN_TYPES if _are_symbols_declared(text, names)}
    for text in filter(lambda text: _are_symbols_declared(text, names), _ARRAY_TYPES):
        members[text] = text.replace("[]", "(*{})[]")
    for text in filter(lambda text: _are_symbols_declared(text, names), _CALLBACK_TYPES):
        members[text] = text.replace("void(", "void (*{})(")
    fields = "".join(f"{member.format(f' _{k}')};" for k, member in enumerate(members.values()))
    ffi.cdef(f"{_NATIVE_TYPES_STRUCT} {{{fields}}};")
    for text, (_, field) in zip(members, ffi.typeof(_NATIVE_TYPES_STRUCT).fields, strict=True):
        # cffi keeps a type beside whether its name was that of a function.
        kind = field.type.item if text in _ARRAY_TYPES else field.type
        parsed_types.setdefault(text, (kind, text in _CALLBACK_TYPES))
    return len(members)


def _parsed_types() -> dict[str, tuple[Any, bool]] | None:
    """Return cffi's table of types by their text, or None if it keeps them elsewhere."""
    from wgpu.backends.wgpu_native import ffi

    parsed_types = getattr(ffi, "_parsed_types", None)
    return parsed_types if isinstance(parsed_types, dict) else None


def _are_symbols_declared(text: str, names: list[str]) -> bool:
    """Return whether the library declares all of its types that a text names."""
    return set(re.findall(r"WGPU\w+", text)) <= set(names)


_CREATE_FUNCTION: Final = "wgpuDeviceCreateShaderModuleTrusted"
_BOUNDED_LOOPS: Final = 2  # a bit of WGPUShaderRuntimeChecks in wgpu.h
_RUNTIME_CHECKS: Final = 0x1F ^ _BOUNDED_LOOPS


def create_shader_module(raw: RawDevice, label: str, code: str) -> ShaderModule:
    """Compile the WGSL text of a shader whose loops all end; other checks of wgpu stay."""
    native_device = getattr(raw, "_internal", None)  # a device that records has none
    create = None if native_device is None else _load_function(_CREATE_FUNCTION)
    if create is None:
        return raw.create_shader_module(label=label, code=code)
    from wgpu.backends.wgpu_native import GPUShaderModule, ffi, lib

    name, text = (ffi.new("char[]", string.encode()) for string in (label, code))
    shader = ffi.new("WGPUShaderSourceWGSL *")
    shader.chain.sType = lib.WGPUSType_ShaderSourceWGSL
    shader.code.data, shader.code.length = text, len(text) - 1
    descriptor = ffi.new("WGPUShaderModuleDescriptor *")
    descriptor.nextInChain = ffi.cast("WGPUChainedStruct *", shader)
    descriptor.label.data, descriptor.label.length = name, len(name) - 1
    return GPUShaderModule(label, create(native_device, descriptor, _RUNTIME_CHECKS), raw)


def timestamp_period(raw: RawDevice) -> float:
    """Return the nanoseconds of a tick of the GPU's clock."""
    queue = getattr(raw.queue, "_internal", None)
    timestamp_period = _load_function("wgpuQueueGetTimestampPeriod")
    return 1.0 if queue is None or timestamp_period is None else float(timestamp_period(queue))


_READ_MODE: Final = "READ_NOSYNC"


def map_for_reading(buffer: Buffer) -> Promise:
    """Begin to map a buffer for reading, once the work that was submitted so far has ended."""
    try:
        return buffer.map_async(_READ_MODE)
    except ValueError:
        return buffer.map_async("READ")


def _load_function(name: str) -> Any:
    """Return a function of wgpu-native that raises errors as wgpu-py does; None without it."""
    from wgpu.backends import wgpu_native

    return getattr(getattr(getattr(wgpu_native, "_api", None), "libf", None), name, None)

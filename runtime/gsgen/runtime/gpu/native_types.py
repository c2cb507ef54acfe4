"""C types of wgpu's native library, parsed together instead of one by one.

wgpu names the type of each structure, array and callback that it makes, as in
``ffi.new("WGPULimits *")``. cffi parses a name that is new to it behind declarations of all typedefs
that it knows: 13 ms for each of the 60 types that a first picture needs. All together take 80 ms.
"""

__all__ = ["parse_native_types"]

import re
from functools import cache
from typing import Any, Final

_STRUCTURE: Final = "struct gsgen_native_types"

# Types besides pointers to structures, as wgpu spells them. Each is a key of cffi's table, so spaces
# count; one that a version of wgpu spells otherwise is parsed when it is needed.
_PLAIN: Final = ("intptr_t", "uintptr_t", "uint8_t *", "uint32_t *", "WGPUChainedStruct * ")
_ARRAYS: Final = (
    *("char []", "char[]", "uint8_t []", "uint8_t[]", "uint32_t []"),
    *("WGPUBindGroupEntry[]", "WGPUBindGroupLayout[]", "WGPUBindGroupLayoutEntry[]"),
    *("WGPUColorTargetState[]", "WGPUCommandBuffer[]", "WGPUConstantEntry[]", "WGPUFeatureName[]"),
    *("WGPURenderPassColorAttachment[]", "WGPUTextureFormat[]"),
    *("WGPUVertexAttribute[]", "WGPUVertexBufferLayout[]"),
)
_CALLBACKS: Final = (
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
    from wgpu.backends import wgpu_native

    ffi: Any = getattr(getattr(wgpu_native, "_ffi", None), "ffi", None)
    parsed = getattr(ffi, "_parsed_types", None)
    if not isinstance(parsed, dict):
        return 0
    names = ffi.list_types()[0]
    members = {f"{name} *": f"{name} *{{}}" for name in names}
    members |= {text: f"{text}{{}}" for text in _PLAIN if _are_known(text, names)}
    for text in filter(lambda text: _are_known(text, names), _ARRAYS):
        members[text] = text.replace("[]", "(*{})[]")
    for text in filter(lambda text: _are_known(text, names), _CALLBACKS):
        members[text] = text.replace("void(", "void (*{})(")
    fields = "".join(f"{member.format(f' _{k}')};" for k, member in enumerate(members.values()))
    ffi.cdef(f"{_STRUCTURE} {{{fields}}};")
    for text, (_, field) in zip(members, ffi.typeof(_STRUCTURE).fields, strict=True):
        # cffi keeps a type beside whether its name was that of a function.
        kind = field.type.item if text in _ARRAYS else field.type
        parsed.setdefault(text, (kind, text in _CALLBACKS))
    return len(members)


def _are_known(text: str, names: list[str]) -> bool:
    """Return whether the library declares all of its types that a text names."""
    return set(re.findall(r"WGPU\w+", text)) <= set(names)

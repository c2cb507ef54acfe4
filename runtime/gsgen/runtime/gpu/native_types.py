"""C types of wgpu's native library, parsed together instead of one by one.

wgpu names the type of each structure that it allocates, as in ``ffi.new("WGPULimits *")``. cffi
parses a name that is new to it behind declarations of all typedefs that it knows: 13 ms for each
of the 40 types that a first picture needs. All pointers together take 80 ms.
"""

__all__ = ["parse_native_types"]

from functools import cache
from typing import Any, Final

_STRUCTURE: Final = "struct gsgen_native_types"


@cache
def parse_native_types() -> int:
    """Parse the pointers to all C types of wgpu's native library, once a process.

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
    fields = "".join(f"{name} *_{number};" for number, name in enumerate(names))
    ffi.cdef(f"{_STRUCTURE} {{{fields}}};")
    for name, (_, field) in zip(names, ffi.typeof(_STRUCTURE).fields, strict=True):
        # cffi keeps a type beside whether its name was that of a function.
        parsed.setdefault(f"{name} *", (field.type, False))
    return len(names)
